"""The pipeline of bodies: from an image to tracked bodies in metres, their joints, and what they express.

`BodyPipeline.update` is the main road: pose network on the known bodies, search for new ones, re-identification,
metric localization, kinematic model (`BodyModeller`), behaviour.
"""

from __future__ import annotations

import math
import time
from collections import deque
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Callable, ContextManager, Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.behaviour.arms import GUESSED_DEPTH
from hri_fullbody.core.behaviour.gesture import GestureClass
from hri_fullbody.core.behaviour.guessed_limbs import without_feet_outside, without_guessed_limbs
from hri_fullbody.core.behaviour.pointing import Pointing, PointingEstimator, aim
from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.behaviour.recognizer import MAX_GAP_S, BehaviourRecognizer, BodyBehaviour
from hri_fullbody.core.detection.pose_estimator import (
    BODY_LANDMARKS,
    BlazePose,
    PoseEstimate,
    PoseEstimator,
    pose_model_path,
)
from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.keypoints import confidence_18, to_18_points
from hri_fullbody.core.localization.ground import GroundPlane
from hri_fullbody.core.localization.localizer import BodyLocalizer, SceneContext, solve_pnp
from hri_fullbody.core.model.anthropometry import MONOCULAR
from hri_fullbody.core.model.human import Layout
from hri_fullbody.core.modeller import BodyInput, BodyModeller, ModelledBody, turned_model
from hri_fullbody.core.parameters import BodiesSettings
from hri_fullbody.core.tracking.camera_motion import CameraMotion
from hri_fullbody.core.tracking.reidentification import BodyReidentifier, Reidentification, TrackAppearance
from hri_fullbody.core.tracking.track import BodyTrack
from hri_fullbody.core.tracking.tracker import SLOW_S, BodyTracker
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.image_rotation import ImageOrientation, ImageRotation
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.onnx import model_path
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.person_detector import DEFAULT_FILE, CenterNetDetector, PersonDetector
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.scheduler import IdleShare, InferenceScheduler
from hri_pipeline.core.timing import StageTimes

_SEEN = 0.5
_SLOW_NEW = 2       # in slow images two windows of the budget are for those who wait
# Images that come more slowly than every so many s have more windows for new bodies, in proportion, until this part of
# the time to the next image is used.
_CALM_STEP, _OF_STEP = 0.1, 0.5
_HIDDEN_SHARE, _HIDDEN_NEW = 0.3, 2     # of the detector's period, and windows for new ones, while somebody is hidden
# Boxes of the person detector from this part of the score that starts a body confirm that somebody is there.
_FAINT = 0.5
_FIRST_COST_S = 0.015   # guess of the time of one inference of the pose network
_HEAD_SAMPLES = 200


Search = Callable[[], Tuple[np.ndarray, np.ndarray]]
"""Waits for the person detector: boxes (N, 4) px and scores (N,)."""


@dataclass(frozen=True)
class _LastModel:
    """The last model of a body, of the image of `stamp` (s), and where the body was then by its observation (m)."""

    stamp: float
    model: ModelledBody
    origin: Optional[np.ndarray]
    behaviour: Optional[BodyBehaviour]


class BodyPipeline:
    """Detects, tracks, localizes and models all bodies of one camera.

    After `update`, `model` and `behaviour` tell what is known of a body beyond its observation.
    """

    def __init__(self, settings: BodiesSettings, notify: Optional[Callable[[str], None]] = None,
                 pose: Optional[PoseEstimator] = None, detector: Optional[PersonDetector] = None,
                 guard: Optional[ItemGuard] = None, threads: Optional[Threads] = None) -> None:
        """Load the networks.

        Parameters
        ----------
        settings : values of `parameters.BODIES` or `parameters.VISION`.
        notify : gets one line of text when an execution provider is missing.
        pose, detector : used instead of the networks of the settings.
        guard : counts errors; an error costs one body at most.
        threads : of the networks; by default as the settings say. They are closed by close().

        Raises
        ------
        ModelError
            A network is missing or damaged.
        ParameterError
            A segments file cannot be used, or settings contradict each other.
        ValueError
            Illegal settings.
        """
        self._settings = settings
        self._threads = threads or Threads.of_node(settings.threads, settings.cpu_share)
        self._pose = pose or BlazePose(pose_model_path(settings.pose_model), settings.providers, notify, self._threads)
        self._detector = detector or CenterNetDetector(
            model_path(settings.person_detector_model, DEFAULT_FILE), threshold=_FAINT * settings.min_person_score,
            long_side=settings.person_detection_size, providers=settings.providers, notify=notify,
            threads=self._threads)
        self._guard = guard or ItemGuard()
        self._tracker = self._make_tracker(settings)
        self._limit_poses(settings)
        self._localizers: Dict[str, BodyLocalizer] = {}
        self._reidentifier = BodyReidentifier(settings.body_memory)
        self._camera_pose: Optional[Pose] = None
        self._camera_motion = CameraMotion()
        self._camera: Optional[CameraModel] = None      # of the last image
        try:
            self._modeller = BodyModeller.from_parameters(settings)
        except (ValueError, OSError) as error:
            raise ParameterError("bodies cannot be modelled: {}".format(error)) from error
        self._ground = GroundPlane()
        self.up = self._ground.up
        """(3,) unit vector against gravity in the optical frame, of the last image."""
        self._floor: Optional[float] = None
        self._recognizers: Dict[str, BehaviourRecognizer] = {}
        self._pointers: Dict[str, PointingEstimator] = {}
        self.pointing: Dict[str, Pointing] = {}
        """Who points in the last image, by body id."""
        self._last_models: Dict[str, _LastModel] = {}
        self._head_distances: Deque[float] = deque(maxlen=_HEAD_SAMPLES)
        self.reidentified: List[Reidentification] = []
        """Bodies confirmed since the last image that were there before under another id."""
        self.modelled: List[ModelledBody] = []
        """Models of the bodies that were detected in the last image."""
        self._orientation = ImageOrientation()
        self._last_stamp = self._last_detection = self._anew_at = -math.inf
        self._detected_before = self._faces_come = False
        self.times = StageTimes()

    def _make_tracker(self, settings: BodiesSettings) -> BodyTracker:
        """Return what follows the bodies by the networks."""
        schedule = InferenceScheduler(cost=_FIRST_COST_S, batches=False, idle=IdleShare(settings.cpu_share),
                                      clock=self._threads.time)
        return BodyTracker(
            self._pose, IdGenerator().new, settings.body_birth_delay, settings.body_death_time, settings.min_body_score,
            settings.max_bodies, guard=self._guard, ignored=IgnoredRegions(settings.ignored_regions),
            is_human=lambda image, box: self._detector.is_human(image, box), schedule=schedule)

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float, faces: Optional[Sequence[FaceBox]] = (),
               depth: Optional[np.ndarray] = None, up: Optional[np.ndarray] = None,
               camera_height: Optional[float] = None, camera_pose: Optional[Pose] = None,
               seen: Optional[Callable[[List[BodyObservation]], None]] = None) -> List[BodyObservation]:
        """Process one image and return its confirmed bodies.

        Bodies without an inference in this image are where their motion takes them, with `measured` False.

        Parameters
        ----------
        bgr : (H, W, 3) image, taken by `camera` at `stamp` (s). A stamp older than the last one starts afresh.
        faces : those of this image or a moment before; optional, but they keep neighbours apart and give the distance.
            None: nobody looks for faces, so that no body waits for its own.
        depth : (h, w) m, registered to the image, NaN or 0 where unknown.
        up : (3,) unit vector against gravity in the optical frame; None: learnt from the people, see GroundPlane.
        camera_height : m above the floor; None: with `up` the floor is not used, without it it is learnt, too.
        camera_pose : of the optical frame in one that stands still and whose z axis points up, while the camera moves:
            who was lost is expected there. None: the camera stands.
        seen : called with the bodies, before new and lost ones are searched for, which come in the next image; after it
            where images are slow, or the detector must be asked about one of them.
        """
        began = time.monotonic()
        self._camera_pose = camera_pose
        if stamp < self._last_stamp:
            self.reset()
        step = stamp - self._last_stamp
        slow = SLOW_S < step < math.inf
        self._last_stamp = stamp
        self._faces_come = faces is not None and (self._faces_come or any(face.pose is not None for face in faces))
        faces = faces or ()
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        faces = self._compensate(bgr, camera, stamp, faces)
        before, self._camera = self._camera or camera, camera
        if camera.is_told_anew(before):
            for track in self._tracker.tracks:
                track.motion.forget_distance()
                self._tracker.schedule.renew(track.id)
        with self._begin_search(bgr, stamp) as search:
            self._follow_known(bgr, camera, stamp, faces, slow)
            self._begin_places_anew(before, camera, stamp)
            faces = [face for face in faces if face.stamp is None or face.stamp >= self._anew_at]
            # The next image is far away, or somebody would be told of whom the detector was not asked yet.
            first = slow or any(track.box_confirmed is None for track in self._tracker.published(stamp))
            if first:
                self._search_new(bgr, stamp, faces, slow, search)
            try:
                bodies = self._observe_all(camera, stamp, faces,
                                           SceneContext(depth, up, camera_height, faces=self._faces_come))
                if seen is not None:
                    seen(bodies)
            finally:        # an error there costs nobody the search
                if not first:
                    self._search_new(bgr, stamp, faces, slow, search)
        if self._tracker.schedule.is_live and _CALM_STEP < step < math.inf:
            self._search_on(bgr, stamp, faces, step / _CALM_STEP - 1.0, began + _OF_STEP * step)
        return bodies

    def _compensate(self, bgr: np.ndarray, camera: CameraModel, stamp: float,
                    faces: Sequence[FaceBox]) -> Sequence[FaceBox]:
        """Move the known bodies with an image whose camera turns; return the faces as they are in it."""
        motion = self._camera_motion
        with self.times("camera motion"):
            motion.update(bgr, camera, stamp, self._tracker.boxes)
        if motion.moves:
            self._tracker.carry(lambda points: motion.moved(points, motion.step()))
        return [motion.face_now(face) for face in faces]

    def _begin_places_anew(self, before: CameraModel, camera: CameraModel, stamp: float) -> None:
        """Let all bodies go at once to where they are now: in a picture that has jumped at `stamp` (s), or by a new
        calibration. Faces of before are elsewhere."""
        jump = self._tracker.jump
        if jump is None and not camera.is_told_anew(before):
            return
        self._anew_at = stamp
        zoom = 1.0 if jump is None else jump.scale
        for localizer in self._localizers.values():
            localizer.forget_places(float(camera.matrix[0, 0] / before.matrix[0, 0]) / zoom, jump)
        self._modeller.forget_places()
        for recognizer in self._recognizers.values():
            recognizer.forget_places()
        self._pointers.clear()
        if camera.is_told_anew(before, zoom):       # of a zoom that the calibration has followed the floor stays
            self._ground.reset()

    def _observe_all(self, camera: CameraModel, stamp: float, faces: Sequence[FaceBox],
                     context: SceneContext) -> List[BodyObservation]:
        """Observe all bodies of this image, and fit their models."""
        up = context.up
        self._reidentify(stamp)
        if up is None:
            self._learn_ground(stamp, faces)
        bodies = self._localize(camera, stamp, faces, context)
        self._forget_all_but(self.tracked_ids)
        learnt = self._ground.camera_height("") if up is None else None
        self._floor = context.camera_height if learnt is None else learnt[0]
        self.up = self._ground.up if up is None else up
        self.fit(bodies, stamp, self.up, (camera.width, camera.height), self._ground.up_sd if up is None else 0.0)
        return bodies

    def fit(self, bodies: Sequence[BodyObservation], stamp: float, up: np.ndarray, size: Tuple[int, int],
            up_sd: float = 0.0) -> None:
        """Fit the kinematic models to the bodies that were detected at `stamp` (s), and recognise their behaviour.

        up: (3,) unit vector against gravity, optical frame; up_sd: standard deviation of its pitch, rad. size: width
        and height of the image, px.
        """
        self._last_stamp = stamp
        seen = {body.id: body for body in bodies if body.measured}
        with self.times("models"):
            self.modelled = self._modeller.update(
                [BodyInput(body.id, body.keypoints_3d, body.keypoints[:, 2], body.head,
                           0.0 if body.by_depth else MONOCULAR, self._size(body.id))
                 for body in seen.values()], stamp, up)
        with self.times("attitude"):
            self.pointing = self._find_pointing(stamp, up)
            self._guard.each("body", lambda model: self._express(model, seen[model.id], stamp, up, size, up_sd),
                             self.modelled)

    def _follow_known(self, bgr: np.ndarray, camera: CameraModel, stamp: float, faces: Sequence[FaceBox],
                      slow: bool) -> None:
        """Run the pose network for the known bodies whose turn it is."""
        self._tracker.schedule.share_among(getattr(self._pose, "threads", ONE_THREAD))
        with self.times("poses"), self.times.in_parts("perspective") as one:

            def place_landmarks(estimate: PoseEstimate) -> Optional[np.ndarray]:
                with one():
                    return self._solve_pnp(estimate, camera)

            self._tracker.follow(bgr, stamp, faces, place_landmarks, _SLOW_NEW if slow else 0)

    def _begin_search(self, bgr: np.ndarray, stamp: float) -> ContextManager[Search]:
        """Let the person detector begin, beside the pose network, when it is due whatever that finds."""
        threads: Threads = getattr(self._detector, "threads", ONE_THREAD)
        if stamp - self._last_detection >= self._settings.person_detection_period:
            return threads.beside(self._run_detector, bgr)
        return nullcontext(lambda: self._run_detector(bgr))

    def _run_detector(self, bgr: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Run the person detector, whose time is its own, also where it runs beside and is hardly waited for."""
        with self.times("person detector"):
            return self._detector.detect(bgr)

    def _search_new(self, bgr: np.ndarray, stamp: float, faces: Sequence[FaceBox], slow: bool, search: Search) -> None:
        """Search for new bodies: with the person detector when it is due, else in a few of the candidate windows.

        When the detector is due in every image, or images are slow, both are done in each. It is asked at once for a
        body that was found without it, and more often while one is hidden.
        """
        if self._tracker.is_blank:
            return
        period = self._settings.person_detection_period * (_HIDDEN_SHARE if self._tracker.awaits_return(stamp) else 1.0)
        due = stamp - self._last_detection >= period or self._tracker.awaits_detector
        detected_before, self._detected_before = self._detected_before, due
        if due:
            self._last_detection = stamp
            boxes, scores = search()
            self._orientation.update(bgr, scores, stamp, self._run_detector)
            self._tracker.propose(list(boxes[scores >= self._settings.min_person_score]), faces, stamp, list(boxes))
            if not detected_before and not slow:
                return
        windows, budget = self._settings.new_windows_per_image, self._settings.pose_budget
        if budget:
            least = _HIDDEN_NEW if self._tracker.awaits_return(stamp) else 1
            windows = min(windows, max(least, budget - self._tracker.windows))
        with self.times("new bodies"):
            self._tracker.try_new(bgr, stamp, faces, windows)

    def _search_on(self, bgr: np.ndarray, stamp: float, faces: Sequence[FaceBox], times: float, until: float) -> None:
        """Use the time up to `until` (s, monotonic clock) for new bodies, after the known ones are told.

        A few windows in each image make a group wait for many images, which may be seconds. times: as often as an image
        has windows for new bodies.
        """
        with self.times("new bodies"):
            for _ in range(int(times * self._settings.new_windows_per_image)):
                if time.monotonic() > until or not self._tracker.try_new(bgr, stamp, faces, 1):
                    return

    def _reidentify(self, stamp: float) -> None:
        """Compare new bodies with those lost in the last seconds."""
        self.reidentified = self._reidentifier.update(
            [self._appearance(track) for track in self._tracker.tracks if track.confirmed], stamp)

    def _appearance(self, track: BodyTrack) -> TrackAppearance:
        """What re-identification needs to know of a body: its stature as of the image before."""
        last, root = self._last_models.get(track.id), track.detection.root
        # What was measured in this image only: the camera has moved since the others.
        place = None if root is None or (self._camera_pose and track.stamp != self._last_stamp) else root
        if place is not None and self._camera_pose is not None:
            x, y, z = self._camera_pose.apply(place[None])[0]
            place = np.array([-y, -z, x])
        return TrackAppearance(track.id, track.appearance, place,
                               None if last is None or not last.model.stature_known else last.model.stature,
                               0.1 if last is None else last.model.stature_sd, track.face_id,
                               track.visible and not track.returning, self._camera_pose is not None,
                               None if root is None else math.hypot(*root.tolist()))

    def appearance(self, body_id: str) -> Optional[np.ndarray]:
        """Return the colours (5, 21) of a body's clothes, see `reidentification.describe`; None while they are not
        known."""
        return next((track.appearance for track in self._tracker.tracks if track.id == body_id), None)

    def _solve_pnp(self, estimate: PoseEstimate, camera: CameraModel) -> Optional[np.ndarray]:
        """Place the landmarks of an estimate in the optical frame: (33, 3) m, or None."""
        return solve_pnp(camera.normalise(estimate.landmarks[:BODY_LANDMARKS, :2]), estimate.world,
                         estimate.confidence[:BODY_LANDMARKS] > _SEEN)

    def _learn_ground(self, stamp: float, faces: Sequence[FaceBox]) -> None:
        """Learn the camera's tilt and height from the bodies that were detected in this image."""
        poses: Dict[str, Optional[Pose]] = {face.id: face.pose for face in faces}
        for track in self._tracker.published(stamp):
            if track.stamp == stamp and track.detection.points is not None:
                confidence = confidence_18(track.estimate.confidence[:BODY_LANDMARKS])
                self._ground.add(track.id, to_18_points(track.detection.points), confidence, stamp,
                                 poses.get(track.face_id or ""))
        self._ground.solve(stamp)

    def _context_of(self, body_id: str, context: SceneContext) -> SceneContext:
        """The scene as it is known for one body: without a measured ground plane, the one that all others tell."""
        if context.up is not None:
            return context
        height = self._ground.camera_height(body_id)
        return context if height is None else replace(
            context, up=self._ground.up, camera_height=height[0], height_sd=height[1])

    def _size(self, body_id: str) -> Optional[Tuple[float, float]]:
        localizer = self._localizers.get(body_id)
        return None if localizer is None else localizer.size

    def _localize(self, camera: CameraModel, stamp: float, faces: Sequence[FaceBox],
                  context: SceneContext) -> List[BodyObservation]:
        """Observations of the bodies to publish, at their metric scale and distance."""
        with self.times("placement"):
            living = {track.id for track in self._tracker.tracks}
            self._localizers = {key: localizer for key, localizer in self._localizers.items() if key in living}
            poses: Dict[str, Optional[Pose]] = {face.id: face.pose for face in faces}
            return self._guard.each(
                "body", lambda track: self._observe(track, camera, stamp, poses.get(track.face_id or ""), context),
                self._tracker.published(stamp))

    def _observe(self, track: BodyTrack, camera: CameraModel, stamp: float, face: Optional[Pose],
                 context: SceneContext) -> BodyObservation:
        localizer = self._localizers.get(track.id) or self._localizers.setdefault(track.id, BodyLocalizer())
        if localizer.measures(track, stamp):
            context = self._context_of(track.id, context)
        return localizer.observe(track, camera, stamp, face, context)

    def _express(self, model: ModelledBody, body: BodyObservation, stamp: float, up: np.ndarray,
                 size: Tuple[int, int], up_sd: float) -> None:
        """Keep the model of a detected body, and recognise its attitude, posture and gesture."""
        points = without_guessed_limbs(model.points, body.keypoints, *size)
        confidence = without_feet_outside(body.keypoints, *size)
        recognizer = self._recognizers.get(model.id) or self._recognizers.setdefault(model.id, BehaviourRecognizer())
        behaviour = self._guard.each(
            "behaviour of a body",
            lambda one: recognizer.update(
                points, one.stature, stamp, up, up_sd, confidence, body.hands,
                1.0 if body.by_depth else GUESSED_DEPTH, body.image_trunk, body.score, body.leaving, self._floor),
            [model])
        self._last_models[model.id] = _LastModel(
            stamp, model, None if body.pose is None else body.pose.translation, behaviour[0] if behaviour else None)
        if body.head is not None:
            self._head_distances.append(math.hypot(*(model.head.translation - body.head.translation).tolist()))

    def _find_pointing(self, stamp: float, up: np.ndarray) -> Dict[str, Pointing]:
        """Who of the bodies of this image points, and at whom or where on the floor."""
        points = {model.id: model.points for model in self.modelled}
        told: Dict[str, Pointing] = {}
        for model in self.modelled:
            pointer = self._pointers.get(model.id) or self._pointers.setdefault(model.id, PointingEstimator())
            ray = pointer.update(model.points, model.stature, stamp, up)
            if ray is not None:
                others = {name: place for name, place in points.items() if name != model.id}
                told[model.id] = aim(ray, others, up, self._floor)
        return told

    @property
    def person_detector(self) -> PersonDetector:
        """What tells where there are people."""
        return self._detector

    @property
    def seen_turn(self) -> Optional[int]:
        """Quarter turns anticlockwise by which people stand upright in the images, None while that is not known."""
        return self._orientation.turn

    def model(self, body: BodyObservation) -> Optional[ModelledBody]:
        """Return the model of a body that is in the image, None while there is none.

        One that was not detected in this image keeps its joints and moves as its observation does; where that has no
        place any more, there is none either.
        """
        last = self._last_models.get(body.id)
        if last is None or body.id in self._modeller.failures:
            return None
        if not body.measured and body.pose is None and last.origin is not None:
            return None
        if body.measured or body.pose is None or last.origin is None:
            return last.model
        way = body.pose.translation - last.origin
        return replace(last.model, pose=last.model.pose.moved(way), head=last.model.head.moved(way))

    def behaviour(self, body_id: str, stamp: float) -> Optional[BodyBehaviour]:
        """Return what a body expresses in the image of `stamp` (s), None when it was not detected in that image."""
        last = self._last_models.get(body_id)
        return None if last is None or last.stamp != stamp else last.behaviour

    def label(self, body_id: str) -> str:
        """Return what is known of a body in a few words, such as `1.72 m, sitting, arms crossed`.

        Posture and gesture are those of the last second; older ones are left out.
        """
        last = self._last_models.get(body_id)
        if last is None:
            return ""
        words = ["{:.2f} m".format(last.model.stature)] if last.model.stature_known else []
        if last.behaviour is not None and self._last_stamp - last.stamp <= MAX_GAP_S:
            words += [value.name.lower().replace("_", " ") for value in (
                PostureClass(last.behaviour.posture), GestureClass(last.behaviour.gesture)) if value]
        return ", ".join(words)

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of the confirmed bodies, also of those that wait for their turn, or were missed only for a while."""
        return [track.id for track in self._tracker.tracks if track.confirmed]

    @property
    def layout(self) -> Layout:
        """Joints of the models."""
        return self._modeller.layout

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics: numbers of bodies, statures, times."""
        values: Dict[str, object] = {
            "tracked": len(self.tracked_ids), "pose_ms": 1e3 * self._tracker.schedule.cost,
            "spare_percent": 100.0 * self._tracker.schedule.spare, "threads": self._tracker.schedule.threads,
            "placed_by_depth": sum(localizer.by_depth for localizer in list(self._localizers.values())),
            "modelled": len(self._last_models),
            "statures_m": ", ".join(
                "{} {:.2f} +- {:.2f}".format(body_id, last.model.stature, last.model.stature_sd)
                if last.model.stature_known else "{} unknown".format(body_id)
                for body_id, last in list(self._last_models.items()))}
        values["camera_tilt_deg"] = "{:.0f} +- {:.0f}".format(
            math.degrees(math.atan2(-self._ground.up[2], -self._ground.up[1])), math.degrees(self._ground.up_sd))
        if self._head_distances:
            values["head_to_face_m_median"] = float(np.median(list(self._head_distances)))
        values.update(self.times.values())
        return values

    def note_timing(self, age: float, took: float) -> None:
        """Note, before update, the age (s) of the image, and the time (s) that the last one took in all."""
        self._tracker.schedule.note_timing(age, took)

    def reconfigure(self, settings: BodiesSettings) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._settings = settings
        self._detector.threshold = _FAINT * settings.min_person_score
        self._tracker.limit(settings.body_birth_delay, settings.body_death_time, settings.min_body_score)
        self._limit_poses(settings)
        self._modeller.reconfigure(settings)

    def _limit_poses(self, settings: BodiesSettings) -> None:
        self._tracker.schedule.limit(settings.pose_rate, most=settings.pose_budget, max_age=settings.max_age,
                                     max_rate=settings.max_rate)
        self._tracker.schedule.set_share(settings.cpu_share)

    def turn(self, rotation: ImageRotation) -> None:
        """Take note that the images are turned by `rotation` from now on, against those before; the bodies stay."""
        self._tracker.turn(rotation)
        self._camera_motion.reset()
        self._camera = None
        for localizer in self._localizers.values():
            localizer.turn(rotation)
        self._ground.reset()
        self._orientation.images_turn()
        self._modeller.turn(rotation)
        for recognizer in self._recognizers.values():
            recognizer.forget_places()
        self._pointers.clear()
        self._last_models = {
            name: replace(last, model=turned_model(last.model, rotation),
                          origin=None if last.origin is None else rotation.vectors(last.origin))
            for name, last in self._last_models.items()}

    def reset(self) -> None:
        """Forget all bodies, for example because time went back."""
        self._tracker.reset()
        self._camera_motion.reset()
        self._camera = None
        self._reidentifier.reset()
        self._localizers.clear()
        self._ground.reset()
        self._orientation.reset()
        self.pointing = {}
        self._modeller.reset()
        self._forget_all_but([])
        self._last_stamp = self._last_detection = self._anew_at = -math.inf
        self._detected_before = False

    def close(self) -> None:
        """End the threads. Idempotent."""
        self._threads.close()

    def _forget_all_but(self, ids: Sequence[str]) -> None:
        self._modeller.retain(ids)
        for known in (self._recognizers, self._last_models, self._pointers):
            for gone in [body_id for body_id in known if body_id not in ids]:
                del known[gone]
