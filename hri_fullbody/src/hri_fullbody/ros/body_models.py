"""The kinematic models of all bodies: joints, frames, descriptions, and what the bodies express."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Deque, Dict, Optional, Sequence, Tuple

import numpy as np
import rospy

from hri_fullbody.core.body_modeller import BodyInput, BodyModeller, ModelledBody
from hri_fullbody.core.human.human_urdf import make_urdf
from hri_fullbody.core.human.stature import MONOCULAR
from hri_fullbody.core.language.body_language import BodyExpression, BodyLanguage
from hri_fullbody.core.language.gesture import Gesture
from hri_fullbody.core.language.posture import Posture, without_guessed_legs
from hri_fullbody.ros.state_publishers import StatePublishers
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.ros.diagnostics import OK

_LOG_PERIOD_S = 10.0
_HEADS = 200


@dataclass
class _Known:
    """The last model of a body, and where the body was then by its observation (m)."""

    model: ModelledBody
    origin: Optional[np.ndarray]
    expression: Optional[BodyExpression]


class BodyModels:
    """Fits a model to each body and keeps its URDF and its robot_state_publisher.

    settings: the values of body_parameters.BODIES.
    Raises ParameterError for settings that contradict each other or a segments file that cannot be used.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        try:
            self._modeller = BodyModeller.from_parameters(settings)
        except (ValueError, OSError) as error:
            raise ParameterError("bodies cannot be modelled: {}".format(error)) from error
        self._languages: Dict[str, BodyLanguage] = {}
        self._known: Dict[str, _Known] = {}
        self._heads: Deque[float] = deque(maxlen=_HEADS)
        self._failures: Dict[str, str] = {}
        self.times = StageTimes()
        self._publishers: Optional[StatePublishers] = None
        if settings.state_publishers:
            self._publishers = StatePublishers(settings.max_bodies, settings.joint_state_rate)

    @property
    def joint_names(self) -> Tuple[str, ...]:
        """Names of the joints without the id of a body."""
        return self._modeller.layout.joint_names

    def keep(self, ids: Sequence[str]) -> None:
        """Forget all bodies but these, with their URDFs and processes."""
        self._modeller.keep(ids)
        for known in (self._languages, self._known, self._failures):
            for gone in [body_id for body_id in known if body_id not in ids]:
                del known[gone]
        if self._publishers is not None:
            self._publishers.keep(ids)

    def update(self, bodies: Sequence[BodyObservation], stamp: float, up: np.ndarray, size: Tuple[int, int]) -> None:
        """Fit the models to the bodies that were looked at in the image of `stamp` (s).

        up: (3,), optical frame. size: width and height of the image, px.
        """
        seen = {body.id: body for body in bodies if body.measured}
        with self.times("models"):
            models = self._modeller.update(
                [BodyInput(body.id, body.keypoints_3d, body.keypoints[:, 2], body.head, 0.0 if body.by_depth else MONOCULAR)
                 for body in seen.values()], stamp, up)
        self._failures = dict(self._modeller.failures)
        with self.times("attitude"):
            for model in models:
                body = seen[model.id]
                origin = None if body.pose is None else body.pose.translation
                self._known[model.id] = _Known(model, origin, self._express(
                    model, without_guessed_legs(model.points, body.keypoints, *size), stamp, up))
                if body.head is not None:
                    self._heads.append(float(np.linalg.norm(model.head.translation - body.head.translation)))
        for model in models:
            self._describe(model)

    def get(self, body: BodyObservation) -> Optional[ModelledBody]:
        """Return the model of a body that is in the image, None while there is none.

        One that was not looked at keeps its joints and moves as its observation does.
        """
        known = self._known.get(body.id)
        if known is None or body.id in self._failures:
            return None
        if body.measured or body.pose is None or known.origin is None:
            return known.model
        moved = body.pose.translation - known.origin
        return replace(known.model, pose=_shifted(known.model.pose, moved), head=_shifted(known.model.head, moved))

    def expression(self, body_id: str) -> Optional[BodyExpression]:
        """Return what a body expresses, None while that is not known."""
        known = self._known.get(body_id)
        return None if known is None else known.expression

    def label(self, body_id: str) -> str:
        """Return what is known of a body in a few words, such as `1.72 m, sitting, arms crossed`."""
        known = self._known.get(body_id)
        if known is None:
            return ""
        words = ["{:.2f} m".format(known.model.stature)]
        if known.expression is not None:
            words += [name_of.name.lower().replace("_", " ") for name_of in (
                Posture(known.expression.posture), Gesture(known.expression.gesture)) if name_of]
        return ", ".join(words)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._modeller.reconfigure(settings)

    def reset(self) -> None:
        """Forget all bodies: time has jumped back."""
        self._modeller.reset()
        self.keep([])

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics; the message is empty when all is well."""
        values: Dict[str, object] = {"modelled": len(self._known)}
        for body_id, known in list(self._known.items()):
            values["stature_m_" + body_id] = "{:.2f} +- {:.2f}".format(known.model.stature, known.model.stature_sd)
        if self._heads:
            values["head_to_face_m_median"] = float(np.median(self._heads))
        values.update(self.times.values())
        if self._publishers is None:
            return OK, "", values
        level, text, more = self._publishers.status()
        values.update({"robot_state_publishers_" + name: value for name, value in more.items()})
        return level, "" if level == OK else text, values

    def close(self) -> None:
        """End all robot_state_publishers and delete the URDFs. Idempotent."""
        if self._publishers is not None:
            self._publishers.close()

    def _express(self, model: ModelledBody, points: np.ndarray, stamp: float,
                 up: np.ndarray) -> Optional[BodyExpression]:
        try:
            return self._languages.setdefault(model.id, BodyLanguage()).update(
                points, model.stature, stamp, up)
        except ValueError as error:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "body %s: its attitude is not known: %s", model.id, error)
            return None

    def _describe(self, model: ModelledBody) -> None:
        """Make the URDF when it is new or another one."""
        if self._publishers is None or model.revision <= self._publishers.revision(model.id):
            return
        urdf = make_urdf(model.dimensions, model.id, self._modeller.layout)
        if not self._publishers.set(model.id, urdf, model.revision):
            rospy.logwarn_throttle(_LOG_PERIOD_S, "more bodies than ~max_bodies: %s has no skeleton frames", model.id)


def _shifted(pose: Pose, by: np.ndarray) -> Pose:
    return Pose(pose.rotation, pose.translation + by)
