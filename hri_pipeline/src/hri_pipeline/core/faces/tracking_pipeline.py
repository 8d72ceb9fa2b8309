"""From an image to tracked faces: the detector now and then, optical flow, and the mesh network as the time allows."""

from __future__ import annotations

import dataclasses
import math
from contextlib import nullcontext
from typing import Any, Callable, ContextManager, Dict, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.appearance import AppearanceMatcher, FaceLook
from hri_pipeline.core.faces.detector import FaceDetection, FaceDetector, Region, load_face_network, wide_region
from hri_pipeline.core.faces.face_geometry import TrackedFace
from hri_pipeline.core.faces.flow import FaceFlow
from hri_pipeline.core.faces.mesh import (
    FaceMesh,
    FaceMeshResult,
    FaceRoi,
    agreement_score,
    bounding_box,
    is_face,
    is_sound,
    roi_from_detection,
    roi_from_mesh,
    turned_roi,
    verification_score,
)
from hri_pipeline.core.faces.parameters import FacePipelineSettings
from hri_pipeline.core.faces.person_verifier import PersonVerifier, load_person_detector
from hri_pipeline.core.faces.scheduler import DetectionScheduler
from hri_pipeline.core.faces.track import LEAST_VERIFICATION, VERIFIED, FaceMeasurement, FaceTrack, face_colours
from hri_pipeline.core.faces.tracker import FaceTracker, explains, is_same_or_part
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.image_rotation import FaceOrientation, ImageRotation
from hri_pipeline.core.images import LONGEST_FLAW, PictureCuts
from hri_pipeline.core.person_detector import PersonDetector
from hri_pipeline.core.picture_jumps import Jump
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.scheduler import IdleShare, InferenceScheduler, Request
from hri_pipeline.core.timing import StageTimes

Search = Callable[[], List[FaceDetection]]
"""Waits for the face detector."""
KEEP_RATIO = 0.2
"""A tracked face is kept down to this fraction of the presence that a new one needs: in profile its presence
flickers."""
RECALL_RATIO = 0.6
"""A known face that was lost is found again down to this fraction of the detection score that a new one needs."""
SURE = 0.9
"""Presence below which a tracked mesh is started again at the detection: near profile its crop drifts."""
CERTAIN = 0.97
"""Presence from which a new face is accepted with a low detection score: a face of 30 px, or half hidden."""
_VERIFIED_PER_IMAGE = 3
"""Most tracks that are verified in one image."""
_DETECTION_AGE = 0.4
"""Fraction of `face_support_time` without a detection after which the detector is asked for where the face is."""
_OVERLAP = 0.1
"""Boxes overlap by so much of the smaller one's sides, or more."""
_PREDICTION_TIME = 0.3
"""Time constant (s) with which the presence of a face that was not measured falls."""
_PANS, _PANNED_S = 0.2, 0.8
"""Speed (image widths per second) at which all faces move when the camera turns, and time (s) for which the whole image
is searched more often then: people come in on one side."""
DARK_PATIENCE = 3.0
"""Death times for which images that show nothing (no light, a covered lens) are as if they had not come."""
ANEW_PERIOD = 0.25
"""Least time (s) between two searches of all the picture for somebody who took another one's place."""


class FaceTrackingPipeline:
    """Detects and tracks faces in an image sequence: the detector now and then, the mesh network as the time allows.

    `detected` tells whether the detector ran on the last image, `sees_anew` whether that has shown faces at suddenly
    other places: the picture has jumped, or the camera's calibration is told anew. Not thread-safe.

    Parameters
    ----------
    settings
        The values of FACE_PIPELINE_PARAMETERS and `providers`.
    times
        Where the time of each step is noted.
    notify
        Called with one line of text for each execution provider that is skipped.
    clock
        Processor time in s, used for the time budget; by default that of all threads that work for this one.
    judge
        Compares the looks of faces; by default by small pictures alone.
    threads
        Share the faces of an image, and run the detector beside the mesh network.
    person_detector
        See FacePipeline.

    Raises
    ------
    ModelError
        When a model file is missing or wrong.
    """

    def __init__(self, settings: FacePipelineSettings, times: StageTimes,
                 notify: Optional[Callable[[str], None]] = None,
                 clock: Optional[Callable[[], float]] = None, judge: Optional[AppearanceMatcher] = None,
                 threads: Threads = ONE_THREAD,
                 person_detector: Optional[Callable[[], PersonDetector]] = None) -> None:
        detector = load_face_network(settings.face_detector_model, "face_detection_full_range.onnx",
                                     FaceDetector.OUTPUTS, settings.providers, notify, threads, (4,),
                                     most_on_cpu=1)
        mesh = load_face_network(settings.face_mesh_model, "face_landmarks_attention.onnx", FaceMesh.OUTPUTS,
                                 settings.providers, notify, threads, (12,), few_on_cpu=True, most_on_cpu=4)
        self._detector = FaceDetector(detector)
        self._detection_scheduler = DetectionScheduler(settings.face_detection_period, settings.face_detection_tiles)
        self._mesh = FaceMesh(mesh)
        self._mesh_scheduler = InferenceScheduler(idle=IdleShare(settings.cpu_share), threads=mesh.threads,
                                                  clock=clock or threads.time)
        self._limit_mesh(settings)
        self._verifier = PersonVerifier(person_detector or (lambda: load_person_detector(settings, notify)),
                                          settings.face_person_lead, notify)
        if person_detector is None:
            self._verifier.prepare()
        self._tracker = FaceTracker(judge=judge, doubts=self._verifier.doubts, **_limits(settings))
        self._cuts = PictureCuts(jumps=True)
        self._orientation = FaceOrientation()
        self._anew_at = self._panned_at = -np.inf
        self._ignored = IgnoredRegions(settings.ignored_regions)
        self._times = times
        self._flow = FaceFlow()
        self._stamp = 0.0
        self._camera: Optional[CameraModel] = None      # of the last image
        self.detected = self.sees_anew = False
        self._set_thresholds(settings)

    def reconfigure(self, settings: FacePipelineSettings) -> None:
        """Apply the values of the live parameters."""
        self._detection_scheduler.set_period(settings.face_detection_period)
        self._limit_mesh(settings)
        self._tracker.limit(**_limits(settings))
        self._verifier.limit(settings.face_person_lead)
        self._set_thresholds(settings)

    def _limit_mesh(self, settings: FacePipelineSettings) -> None:
        self._mesh_scheduler.limit(settings.face_mesh_rate, 1e-3 * settings.face_budget, max_age=settings.max_age,
                                   max_rate=settings.max_rate)
        self._mesh_scheduler.set_share(settings.cpu_share)

    def _set_thresholds(self, settings: FacePipelineSettings) -> None:
        self._min_score, self._min_presence = settings.min_detection_score, settings.min_face_presence
        self._detection_age = _DETECTION_AGE * settings.face_support_time
        self._longest_dark = max(DARK_PATIENCE * settings.face_death_time, LONGEST_FLAW)
        self._detector.set_min_score(RECALL_RATIO * self._min_score)

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of all faces being tracked, oldest first: those seen in the last image and those just hidden."""
        return self._tracker.ids

    @property
    def all_ids(self) -> Set[str]:
        """Ids of all tracks, unconfirmed ones too."""
        return {track.id for track in self._tracker.tracks}

    @property
    def seen_turn(self) -> Optional[int]:
        """Quarter turns anticlockwise by which faces stand upright in the images, None while that is not known."""
        return self._orientation.turn

    @property
    def scheduler(self) -> InferenceScheduler:
        """Who gets the mesh network."""
        return self._mesh_scheduler

    def update(self, bgr: np.ndarray, stamp: float,
               followed: Optional[Callable[[List[TrackedFace]], None]] = None,
               camera: Optional[CameraModel] = None) -> List[TrackedFace]:
        """Return the faces seen in an image, oldest first, unconfirmed ones too.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        stamp
            Time of the image, s.
        followed
            Called before the detector searches the image, with the published faces that are where they were expected:
            they need not wait for it.
        camera
            Camera model of the image's size, for what the networks see of faces; None: not known.
        """
        with self._times("face_flow"):
            was_blank, cut = self._cuts.blank, self._cuts.update(bgr, stamp)
            if self._cuts.blank and stamp - self._cuts.shown_at <= self._longest_dark:
                self.detected = self.sees_anew = False
                return []
            if was_blank and not self._cuts.blank:
                self._search_anew(stamp)
            if self._cuts.jump is not None:
                self._jump(self._cuts.jump, stamp)
            self._predict(bgr, stamp)
        before, self._camera = self._camera, camera
        told_anew = camera is not None and before is not None and camera.is_told_anew(before)
        self.sees_anew = told_anew or self._cuts.jump is not None
        expected = self._tracker.expected(stamp)
        self._mesh_scheduler.share_among(self._mesh.threads, together=self._mesh.together_on_card(len(expected)))
        chosen = set(self._mesh_scheduler.choose(self._requests(expected, stamp), stamp))
        if cut or self.sees_anew:       # nobody is told without a look
            chosen = {track.id for track in expected}
        if cut:
            self._verifier.reset()
            self._search_anew(stamp)
        skipped = {track.id for track in expected} - chosen
        with self._begin_search(bgr, stamp) as search:
            found = self._measure_tracks(bgr, [track for track in expected if track.id in chosen], stamp)
            try:
                if followed is not None and search is not None and not cut:
                    followed(self._followed(expected, skipped, found, stamp))
            finally:        # an error there costs nobody the search
                measured = list(found.values())
                measured += self._detect(bgr, search, measured, skipped, stamp)
                self._ask_about_doubted(bgr, stamp, set() if cut else skipped.union(found))
                seen = self._tracker.update(measured, stamp, skipped, (bgr.shape[1], bgr.shape[0]), cut)
        if self._tracker.replaced:
            self._search_anew(stamp)
        return [self._tracked_face(track, stamp) for track in seen]

    def take_templates(self, templates: Mapping[str, np.ndarray], stamp: float) -> None:
        """Take templates (D,) by id, which recognition has made of faces in the image of `stamp` (s)."""
        self._tracker.take_templates(templates, stamp)

    def turn(self, rotation: ImageRotation) -> None:
        """Turn everything that is known of earlier images."""
        self._ignored.turn(rotation.quarters)
        self._camera = None
        self._flow.turn(rotation)
        self._cuts.turn(rotation)
        self._orientation.images_turn()
        self._verifier.reset()
        self._detection_scheduler.reset()
        for track in self._tracker.tracks:
            track.turn(rotation)

    def _jump(self, jump: Jump, stamp: float) -> None:
        """Move all that is known of earlier images with a picture that has jumped."""
        for track in self._tracker.tracks:
            track.jump(jump)
        self._flow.reset()
        self._verifier.reset()
        self._search_anew(stamp)

    def reset(self) -> None:
        """Drop every face, as after a jump in time; ids are not used again."""
        self._tracker.reset()
        self._verifier.reset()
        self._detection_scheduler.reset()
        self._mesh_scheduler.reset()
        self._flow.reset()
        self._cuts.reset()
        self._orientation.reset()
        self._anew_at = self._panned_at = -np.inf
        self._camera = None

    def _ask_about_doubted(self, bgr: np.ndarray, stamp: float, present: Set[str]) -> None:
        """Find out what is around new faces that are not sure, of those that are in this image by their ids."""
        doubted = [track for track in self._tracker.doubted if track.id in present]
        if doubted:
            with self._times("face_surroundings"):
                self._verifier.verify(bgr, doubted, stamp)

    def _search_anew(self, stamp: float) -> None:
        """Let the detector search everywhere next time, but not more often than once in `ANEW_PERIOD`."""
        if stamp - self._anew_at >= ANEW_PERIOD:
            self._detection_scheduler.reset()
            self._anew_at = stamp

    def _requests(self, tracks: Sequence[FaceTrack], stamp: float) -> List[Request]:
        """Who could get the mesh network: faces that overlap others first, for the data association; those that move,
        speak, are near or uncertain more often."""
        first = set(self._overlapping(tracks, stamp))
        largest = max([1.0] + [track.size for track in tracks])
        return [Request(track.id, track.urgency(largest) + (
            0.0 if self._tracker.is_confirmed(track) or track.refused else 1.0), track.id in first) for track in tracks]

    def _predict(self, bgr: np.ndarray, stamp: float) -> None:
        """Move the tracks by optical flow."""
        tracks = [track for track in self._tracker.tracks if track.visible]
        boxes = [track.predicted_box(self._stamp) for track in tracks]
        ahead = [track.shift(stamp) - track.shift(self._stamp) for track in tracks]
        motions = self._flow.update(bgr, boxes, ahead)
        for track, motion in zip(tracks, motions):
            track.move(motion, stamp)
        known = [math.hypot(*motion.tolist()) for motion in motions if motion is not None]
        if known and min(known) > _PANS * bgr.shape[1] * (stamp - self._stamp) > 0.0:
            self._panned_at = stamp
        self._stamp = stamp

    def _measure_tracks(self, bgr: np.ndarray, tracks: Sequence[FaceTrack],
                        stamp: float) -> Dict[str, FaceMeasurement]:
        """Run the mesh network at the predicted places of tracks; returns what it finds by their ids."""
        if not tracks:
            return {}
        try:
            with self._times("face_mesh"), self._mesh_scheduler.measure() as count:
                rois = [track.roi(stamp, self._camera) for track in tracks]
                results = self._mesh.run(bgr, rois)
                count(len(rois))
        except Exception:       # this image is lost, and what the detector finds in it
            if self.detected:
                self._detection_scheduler.lose()
            for track in tracks:
                self._mesh_scheduler.renew(track.id)
            raise
        height, width = bgr.shape[:2]
        return {track.id: self._measurement(bgr, result, track.score) for track, result in zip(tracks, results)
                if is_face(result, width, height, self._least_presence(track))}

    def _followed(self, tracks: Sequence[FaceTrack], skipped: Set[str], found: Mapping[str, FaceMeasurement],
                  stamp: float) -> List[TrackedFace]:
        """Published faces of which nothing that the detector may find can tell that they are somebody else, or
        elsewhere: alone, seen in the last image, and looking as they did."""
        crowded = set(self._overlapping(tracks, stamp))
        faces = []
        for track in tracks:
            if not (track.published and track.visible and self._tracker.is_confirmed(track)) or track.id in crowded:
                continue
            one = found.get(track.id)
            if track.id in skipped:
                if track.measurement.presence >= SURE:      # see _without_known
                    faces.append(self._tracked_face(track, stamp))
            elif one is not None and one.presence >= SURE and not track.is_unusual(one, stamp):
                faces.append(TrackedFace(track.id, one.mesh, one.box, one.presence, True, True))
        return faces

    def _least_presence(self, track: FaceTrack) -> float:
        """Presence from which a track goes on: higher while the detector has seen it once at most, with a low score."""
        doubtful = track.hit_count < 1.0 and not self._tracker.is_confirmed(track)
        return SURE if doubtful else KEEP_RATIO * self._min_presence

    def _hit_weight(self, detection: FaceDetection) -> float:
        """How much a detection adds to the hit count, 0 to 1: false detections come now and then, with half the
        score."""
        return min(1.0, detection.score / self._min_score) ** 2

    def _begin_search(self, bgr: np.ndarray, stamp: float) -> "ContextManager[Optional[Search]]":
        """Let the detector begin when it is due, beside the mesh network where there are threads."""
        regions = self._detection_scheduler.due(bgr, stamp, self._unconfirmed(stamp), self._is_stable(),
                                                0.0 <= stamp - self._panned_at <= _PANNED_S)
        self.detected = bool(regions)
        return self._detector.threads.beside(self._run_detector, bgr, regions) if regions else nullcontext()

    def _run_detector(self, bgr: np.ndarray, regions: Sequence[Region]) -> List[FaceDetection]:
        """Run the detector, whose time is its own, also where it runs beside and is hardly waited for."""
        with self._times("face_detection"):
            return self._detector.detect(bgr, regions)

    def _detect(self, bgr: np.ndarray, search: Optional[Search], measured: Sequence[FaceMeasurement],
                skipped: Set[str], stamp: float) -> List[FaceMeasurement]:
        """Take what the detector has found; returns the measurements of new and of lost faces."""
        if search is None:
            return []
        detections = search()
        self._orientation.update(bgr, stamp, self._detect_anywhere)
        hits = self._tracker.add_detections([detection.box for detection in detections], stamp,
                                            [self._hit_weight(detection) for detection in detections],
                                            [detection.score for detection in detections],
                                            [roi_from_detection(detection) for detection in detections])
        self._verify(bgr, [track for track in hits if self._needs_verification(track)], stamp)
        new = [detection for detection in self._without_known(detections, measured, skipped, stamp)
               if self._is_wanted(detection, bgr, stamp)]
        if any(detection.score >= self._min_score for detection in new):
            self._detection_scheduler.hurry(stamp)
        with self._times("face_birth"):
            return self._measure_detections(bgr, new)

    def _detect_anywhere(self, bgr: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Boxes (N, 4) px and scores (N,) of all faces of an image."""
        found = self._run_detector(bgr, [wide_region(bgr.shape[1], bgr.shape[0])])
        return np.array([one.box for one in found]), np.array([one.score for one in found])

    def _without_known(self, detections: Sequence[FaceDetection], measured: Sequence[FaceMeasurement],
                       skipped: Set[str],
                       stamp: float) -> List[FaceDetection]:
        """Detections where no mesh is sure: new faces, and known ones that were lost or whose mesh holds on to a
        part."""
        known = [(measurement.box, measurement.score) for measurement in measured if measurement.presence >= SURE]
        known += [(track.predicted_box(stamp), track.score) for track in self._tracker.tracks
                  if track.id in skipped and track.visible and track.measurement.presence >= SURE]
        return [detection for detection in detections
                if not any(explains(box, score, detection.box, detection.score) for box, score in known)]

    def _is_wanted(self, detection: FaceDetection, bgr: np.ndarray, stamp: float) -> bool:
        """Whether a detection may be of a known face, or of one that takes the place of a known one."""
        size = (bgr.shape[1], bgr.shape[0])
        if self._tracker.has_room_for(detection.box, size) and not self._ignored.contain(detection.box, size):
            return True
        return any(is_same_or_part(detection.box, track.predicted_box(stamp)) for track in self._tracker.tracks)

    @staticmethod
    def _needs_verification(track: FaceTrack) -> bool:
        """Whether a track is not verified and was never published."""
        return track.verification < VERIFIED and not track.published

    def _verify(self, bgr: np.ndarray, tracks: Sequence[FaceTrack], stamp: float) -> None:
        """Verify tracks that the detector sees in this image, the best verified first."""
        chosen = sorted(tracks, key=lambda track: -track.verification)[:_VERIFIED_PER_IMAGE]
        rois = [track.roi(stamp, self._camera) for track in chosen]
        straight = self._mesh.run(bgr, rois)
        for track, score in zip(chosen, self._verified(bgr, rois, straight, [track.score for track in chosen])):
            track.add_verification(score)

    def _verified(self, bgr: np.ndarray, rois: Sequence[FaceRoi], straight: Sequence[FaceMeshResult],
                  scores: Sequence[float]) -> List[float]:
        """Scores -1 (no face) to 1 (a face) of meshes by what a turned crop shows, and a second look of the detector.

        scores: 0 to 1, of their detections.
        """
        turned = self._mesh.run(bgr, [turned_roi(roi) for roi in rois])
        sound = [index for index, result in enumerate(straight) if is_sound(result)]
        again = dict(zip(sound, self._detector.look_again(bgr, [bounding_box(straight[i].points) for i in sound])))
        return [min(verification_score(score, result, other),
                    agreement_score(again.get(index), result, self._min_score))
                for index, (score, result, other) in enumerate(zip(scores, straight, turned))]

    def _measure_detections(self, bgr: np.ndarray, detections: Sequence[FaceDetection]) -> List[FaceMeasurement]:
        """Run the mesh network twice at detections: their box gives a coarse crop, the first mesh gives a good one."""
        height, width = bgr.shape[:2]
        asked = [roi_from_detection(detection) for detection in detections]
        sound = [(detection, crop, roi_from_mesh(result.points, camera=self._camera)) for detection, crop, result
                 in zip(detections, asked, self._mesh.run(bgr, asked)) if is_sound(result)]
        rois = [roi for _, _, roi in sound]
        results = self._mesh.run(bgr, rois)
        verified = self._verified(bgr, rois, results, [detection.score for detection, _, _ in sound])
        return [dataclasses.replace(
                    self._measurement(bgr, result, detection.score),
                    may_start=detection.score >= self._min_score or result.presence >= CERTAIN,
                    hit_weight=self._hit_weight(detection), verification=score, crops=(crop, roi))
                for (detection, crop, roi), result, score in zip(sound, results, verified)
                if is_face(result, width, height, self._min_presence)]

    def _measurement(self, bgr: np.ndarray, result: FaceMeshResult, score: float) -> FaceMeasurement:
        """What is measured of a face that is known already; score: that of its detection or track, 0 to 1."""
        return FaceMeasurement(result.points, result.presence, False, face_colours(bgr, bounding_box(result.points)),
                               0.0, score, 0.0, FaceLook(bgr, result.points, self._camera))

    def _unconfirmed(self, stamp: float) -> List[np.ndarray]:
        """Centres (2,) px of the faces that are not confirmed yet, or were not detected for long."""
        boxes = [track.predicted_box(stamp) for track in self._tracker.tracks if not _is_rejected(track)
                 if not self._tracker.is_confirmed(track) or stamp - track.detected_at > self._detection_age]
        return [(box[:2] + box[2:]) / 2.0 for box in boxes]

    def _is_stable(self) -> bool:
        """Whether there are faces, and all of them are confirmed and seen."""
        tracks = [track for track in self._tracker.tracks if not _is_rejected(track)]
        return bool(tracks) and all(track.visible and self._tracker.is_confirmed(track) for track in tracks)

    @staticmethod
    def _overlapping(tracks: Sequence[FaceTrack], stamp: float) -> List[str]:
        """Ids of faces that overlap others."""
        if len(tracks) < 2:
            return []
        boxes = np.stack([track.predicted_box(stamp) for track in tracks])
        low, high = boxes[:, :2], boxes[:, 2:]
        side = np.minimum((high - low)[:, None], (high - low)[None])
        both = np.minimum(high[:, None], high[None]) - np.maximum(low[:, None], low[None]) > _OVERLAP * side
        both[np.arange(len(tracks)), np.arange(len(tracks))] = False
        return [track.id for track, overlaps in zip(tracks, both.all(axis=2).any(axis=1).tolist()) if overlaps]

    def _tracked_face(self, track: FaceTrack, stamp: float) -> TrackedFace:
        measured = track.measured_at >= stamp
        mesh, box, presence = track.measurement.mesh, track.measurement.box, track.measurement.presence
        if not measured:
            mesh, box = mesh.copy(), track.predicted_box(stamp)
            mesh[:, :2] += track.shift(stamp)
            presence *= math.exp(-(stamp - track.measured_at) / _PREDICTION_TIME)
        return TrackedFace(track.id, mesh, box, presence, measured, self._tracker.is_confirmed(track))


def _limits(settings: FacePipelineSettings) -> Dict[str, Any]:
    """Arguments of FaceTracker.limit()."""
    return {"birth_delay": settings.face_birth_delay, "death_time": settings.face_death_time,
            "max_faces": settings.max_faces,
            "min_detections": settings.face_min_detections, "support_time": settings.face_support_time}


def _is_rejected(track: FaceTrack) -> bool:
    """Whether the verification has failed often enough, or there is no person around it: the detector need not run for
    this track."""
    return (track.verification <= LEAST_VERIFICATION or track.refused) and not track.published
