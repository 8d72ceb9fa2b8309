"""The URDF of one human, as text: links, joints and a body to look at; no inertia, no meshes, no xacro."""

from __future__ import annotations

from typing import Dict, List, Tuple
from xml.sax.saxutils import quoteattr

from hri_fullbody.core.human.human_model import PAPER, Dimensions, Layout
from hri_fullbody.core.human.human_visuals import MATERIALS, Shape, body_shapes
from hri_pipeline.core.ids import ID_PATTERN, is_valid_id

_HEADER = '<?xml version="1.0"?>\n<robot name={}>\n'
_MATERIAL = '<material name="{}"><color rgba="{:g} {:g} {:g} 1"/></material>\n'
_JOINT = ('<joint name="{name}_{id}" type="{type}"><parent link="{parent}_{id}"/><child link="{child}_{id}"/>'
          '<origin xyz="{x:.9g} {y:.9g} {z:.9g}" rpy="0 0 0"/>{motion}</joint>\n')
_MOTION = '<axis xyz="{:g} {:g} {:g}"/><limit lower="{:.6g}" upper="{:.6g}" effort="1000" velocity="20"/>'
_SPHERE = ('<visual><origin xyz="%.4f %.4f %.4f"/><geometry><sphere radius="%.4f"/></geometry>'
           '<material name="%s"/></visual>')
_CYLINDER = ('<visual><origin xyz="%.4f %.4f %.4f" rpy="0 %.4f %.4f"/><geometry><cylinder radius="%.4f" length="%.4f"/>'
             '</geometry><material name="%s"/></visual>')
_SIDES = (("l_", 1.0), ("r_", -1.0))


def make_urdf(dimensions: Dimensions, body_id: str, layout: Layout = PAPER, visuals: bool = True) -> str:
    """Make the URDF of a body; every link and joint name ends in `_ID`.

    Raises ValueError for an id that does not match `ID_PATTERN`. Takes about half a millisecond.
    """
    if not is_valid_id(body_id):
        raise ValueError("body id {!r} is not legal; it must match {}".format(body_id, ID_PATTERN))
    shapes = body_shapes(dimensions) if visuals else {}
    parts = [_HEADER.format(quoteattr("human_" + body_id))]
    if visuals:
        parts += [_MATERIAL.format(name, *colour) for name, colour in MATERIALS.items()]
    parts += ['<link name="{}_{}">{}</link>\n'.format(name, body_id, _visual_text(shapes.get(name, ())))
              for name in link_names(layout)]
    places = _joint_places(dimensions, layout)
    for joint in layout.joints:
        motion = _MOTION.format(*joint.axis, joint.lower, joint.upper)
        parts.append(_joint_text(joint.name, body_id, joint.parent, joint.child, places[joint.name], motion))
    for name, parent, place in _fixed_joints(dimensions):
        parts.append(_joint_text(name, body_id, parent, name, place, ""))
    parts.append("</robot>\n")
    return "".join(parts)


def link_names(layout: Layout = PAPER) -> List[str]:
    """Names of all links without the body's id, the root `body` first."""
    names = ["body"] + [joint.child for joint in layout.joints] + ["torso", "head"]
    return names + [side + end for side, _ in _SIDES for end in ("wrist", "ankle")]


def _joint_text(name: str, body_id: str, parent: str, child: str, place: Tuple[float, float, float],
                motion: str) -> str:
    return _JOINT.format(name=name, id=body_id, type="revolute" if motion else "fixed", parent=parent, child=child,
                         x=place[0], y=place[1], z=place[2], motion=motion)


def _joint_places(dimensions: Dimensions, layout: Layout) -> Dict[str, Tuple[float, float, float]]:
    """Origin (m, in the parent's axes) of each moving joint."""
    places = {joint.name: (0.0, 0.0, 0.0) for joint in layout.joints}
    places["r_head"] = (0.0, 0.0, dimensions.neck_pivot)
    for side, sign in _SIDES:
        first_hip = next(joint.name for joint in layout.joints if joint.parent == "body" and joint.name[:2] == side)
        places[first_hip] = (0.0, sign * dimensions.half_hips, 0.0)
        places[side + "y_shoulder"] = (0.0, sign * dimensions.half_shoulders, 0.0)
        places[side + "elbow"] = (0.0, 0.0, -dimensions.upper_arm)
        places[side + "knee"] = (0.0, 0.0, -dimensions.thigh)
    return places


def _fixed_joints(dimensions: Dimensions) -> List[Tuple[str, str, Tuple[float, float, float]]]:
    """Name (also of the child), parent and origin (m) of each fixed joint."""
    x, y, z = dimensions.head_offset.tolist()
    joints = [("torso", "waist", (0.0, 0.0, dimensions.trunk)), ("head", "p_head", (x, y, z))]
    for side, _ in _SIDES:
        joints.append((side + "wrist", side + "elbow", (0.0, 0.0, -dimensions.forearm)))
        joints.append((side + "ankle", side + "knee", (0.0, 0.0, -dimensions.shank)))
    return joints


def _visual_text(shapes: Tuple[Shape, ...]) -> str:
    """Visual elements of one link."""
    return "".join(
        _SPHERE % (shape.place + (shape.radius, shape.material)) if shape.length == 0.0 else
        _CYLINDER % (shape.place + (shape.pitch, shape.yaw, shape.radius, shape.length, shape.material))
        for shape in shapes)
