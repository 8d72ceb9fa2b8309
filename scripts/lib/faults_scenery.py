"""What runs while things are broken: simulated people, or photographed people and recorded speech."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple, Tuple

from faults_stage import BAG_TESTS

SPEECH = Path("/usr/share/pocketsphinx/test/data/cards")
PICTURE = "sample5.jpg"
PEOPLE = ("ann", "bob", "cho", "dan", "eve")
_SIMULATED = """<include file="{tests}/people.launch">
  <arg name="respawn" value="true"/> <arg name="sim_time" value="false"/> <arg name="store" value="{{store}}"/>
</include>"""
_SCENE = """<include file="$(find hri_pipeline)/launch/scene_simulator.launch">
  <arg name="scene" value="{tests}/five_stand.yaml"/> <arg name="respawn" value="true"/>
</include>
<param name="scene_simulator/matches" value="false"/>"""
_REAL = """<include file="$(find ros4hri)/launch/ros4hri.launch">
  <arg name="store" value="{{store}}"/> <arg name="overlay" value="false"/> <arg name="one_process" value="{one_process}"/>
  <arg name="depth" value="/camera/depth/image_raw"/> <arg name="voices" value="{hears}"/> <arg name="microphone_frame" value="microphone"/>
  <arg name="speech_grammar" value="{speech}/cards.gram"/>
</include>
<node name="camera_in_map" pkg="tf2_ros" type="static_transform_publisher" args="0 0 1.5 -0.5 0.5 -0.5 0.5 map camera_color_optical_frame"/>
<node name="microphone_in_map" pkg="tf2_ros" type="static_transform_publisher" args="0 0 1.5 0 0 0 1 map microphone"/>"""
_CAMERA = """<include file="$(find hri_pipeline)/launch/image_source.launch">
  <arg name="source" value="{picture}"/> <arg name="rate" value="10"/> <arg name="respawn" value="true"/>
  <arg name="image" value="/camera/image_raw"/> <arg name="camera_info" value="/camera/camera_info"/>
</include>"""
_MICROPHONE = """
<include file="$(find hri_pipeline)/launch/sound_source.launch">
  <arg name="source" value="{speech}"/> <arg name="audio" value="/audio"/> <arg name="audio_info" value="/audio_info"/>
  <arg name="respawn" value="true"/>
</include>"""
_MINDS = ("/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions")


class Scenery(NamedTuple):
    """Launch files (stack: with a place for {store}), and what to expect of them.

    names: who is there, empty where only the number is known, count. nodes, sources: what is killed. skeletons: there are
    robot_state_publishers. hears: there is a recogniser of speech. not_flooded: begins of topics that are no inputs from outside.
    """

    stack: str
    source: str
    nodes: Tuple[str, ...]
    sources: Tuple[str, ...]
    names: Tuple[str, ...] = ()
    count: int = 5
    skeletons: bool = False
    hears: bool = False
    not_flooded: Tuple[str, ...] = ()


def scenery(name: str, folder: Path) -> Scenery:
    """Return the scenery of a world; a picture is made in `folder`. Raises RuntimeError when something is missing for it."""
    if name in ("simulated", "disk"):
        return Scenery(_SIMULATED.format(tests=BAG_TESTS), _SCENE.format(tests=BAG_TESTS), _MINDS, ("/scene_simulator",), PEOPLE,
                       not_flooded=("/humans/persons/",))
    return _real(folder, name == "vision")


def _real(folder: Path, one_process: bool) -> Scenery:
    """Photographed people: with faces and bodies in one process and no sound, or in two and with speech."""
    import cv2
    from benchmark_scenes import one_picture
    if not SPEECH.is_dir():
        raise RuntimeError("{} is missing: apt install pocketsphinx-testdata".format(SPEECH))
    models = Path(os.environ.get("ROS4HRI_MODELS") or Path.home() / ".cache/ros4hri/models")
    picture = folder / "people.png"
    try:
        cv2.imwrite(str(picture), one_picture(models / "demo" / PICTURE))
    except OSError as error:
        raise RuntimeError(str(error)) from error
    stack = _REAL.format(one_process=str(one_process).lower(), hears=str(not one_process).lower(), speech=SPEECH)
    camera, microphone = _CAMERA.format(picture=picture), _MICROPHONE.format(speech=SPEECH)
    sensors_only = ("/humans/", "/tf", "/rosout", "/diagnostics")
    if one_process:
        minds = tuple(node for node in _MINDS if node != "/hri_voice_matcher")
        return Scenery(stack, camera, ("/hri_vision", *minds), ("/image_source",), skeletons=True, not_flooded=sensors_only)
    return Scenery(stack, camera + microphone, ("/hri_faces", "/hri_bodies", "/hri_voices", *_MINDS), ("/image_source", "/sound_source"),
                   skeletons=True, hears=True, not_flooded=sensors_only)
