"""Places searched for new bodies: other windows on the next tries, and neighbours that catch a window."""

import numpy as np
from synthetic_people import standing_at

from hri_fullbody.core.detection.pose_estimator import PoseEstimate
from hri_fullbody.core.detection.windows import BOX_WINDOW_SIZES, window_from_person_box
from hri_fullbody.core.tracking.candidates import BodyCandidate, CandidateQueue

BOX = np.array([100.0, 50.0, 200.0, 350.0])


def test_each_try_of_a_box_has_another_size_and_the_last_one_gives_up():
    nobody = standing_at(150.0, 200.0, score=0.01)
    candidate, sizes = BodyCandidate(box=BOX), []
    for attempt in range(len(BOX_WINDOW_SIZES)):
        sizes.append(candidate.window(None).size)
        assert candidate.retried == (attempt > 0)
        result = candidate.judge(nobody, None, 0.5)
        assert result.failed == (attempt == len(BOX_WINDOW_SIZES) - 1)
    usual = window_from_person_box(BOX).size
    assert np.allclose(np.array(sizes) / usual, (1.0, 0.8, 1.15, 1.35))


def test_a_box_of_which_nothing_is_seen_lets_the_others_go_first():
    queue = CandidateQueue()
    queue.offer_boxes([BOX, BOX + 300.0], [])
    first = queue.take()
    queue.put_back(first)
    assert queue.take() is not first and queue.take() is first
    first.first = PoseEstimate(0.9, np.zeros((39, 3)), np.ones(39), np.zeros((33, 3)))
    queue.offer_boxes([BOX + 300.0], [])
    queue.put_back(first)
    assert queue.take() is first
