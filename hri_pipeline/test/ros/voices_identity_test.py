#!/usr/bin/env python3
"""A voice is enrolled, known again, exported and forgotten, through the service ~gallery and the candidate matches."""

import json

import numpy as np
import rospy
import rostest
import soundfile
from microphone import DATA, RATE, noise
from voices_case import LIMIT, VoicesCase

from hri_msgs.msg import IdsMatch, PrivacyNotice
from hri_pipeline.core.onnx import ModelError, model_path
from hri_pipeline.srv import Gallery
from hri_pipeline.testing import wait_for

READER = ("0870", "0880")


class VoicesIdentityTest(VoicesCase):

    def setUp(self):
        try:
            model_path("", "speaker_embedding.onnx").stat()
        except (ModelError, OSError) as error:
            self.skipTest(str(error))
        super().setUp()
        self.matches, self.notices = [], []
        self.listen("/humans/candidate_matches", IdsMatch, self.matches.append)
        self.listen("/humans/privacy", PrivacyNotice, self.notices.append)
        rospy.wait_for_service("/hri_voices/gallery", LIMIT)
        self.gallery = rospy.ServiceProxy("/hri_voices/gallery", Gallery)

    def reader(self):
        """Some seconds of one person who reads, and a pause behind."""
        parts = [soundfile.read(DATA + "librivox/sense_and_sensibility_01_austen_64kb-{}.wav".format(number))[0]
                 for number in READER]
        sound = np.concatenate(parts + [np.zeros(RATE)])
        return sound * (0.5 / np.abs(sound).max()) + noise(len(sound) / RATE + 1.0)[:len(sound)]

    def test_a_voice_is_known_again_until_it_is_forgotten(self):
        self.microphone.play(self.reader())
        voice = self.hear_somebody()
        self.assertFalse(self.gallery(command="enrol", id="", other="nobody").success)
        reader = wait_for(lambda: self.gallery(command="enrol", id="", other=voice).id, LIMIT, "the voice is learnt")
        self.assertEqual(json.loads(self.gallery(command="list").data), [reader])
        self.assertEqual(json.loads(self.gallery(command="export", id=reader).data),
                         {"id": reader, "templates": 1, "enrolled": True})
        wait_for(lambda: not self.tracked(), LIMIT, "it is let go")

        self.microphone.play(self.reader())
        other = wait_for(self.tracked, LIMIT, "another voice")[-1]
        self.assertNotEqual(other, voice)
        match = wait_for(lambda: [one for one in self.matches if one.id1 == other], LIMIT, "whose voice it is")[0]
        self.assertEqual((match.id1_type, match.id2, match.id2_type), (IdsMatch.VOICE, reader, IdsMatch.PERSON))
        self.assertGreater(match.confidence, 0.9, "it is told when it is rather certain")

        self.assertTrue(self.gallery(command="forget", id=reader).success)
        wait_for(lambda: self.matches[-1].confidence == 0.0, LIMIT, "the match is withdrawn")
        gone = self.gallery(command="export", id=reader)
        self.assertTrue(not gone.success and gone.unknown)
        notice = wait_for(lambda: [one for one in self.notices if one.node == "/hri_voices"], LIMIT, "the notice")[-1]
        self.assertIn("voice_identity", notice.computes)
        self.assertEqual(notice.store, "", "without ~gallery nothing is kept beyond the run")


if __name__ == "__main__":
    rospy.init_node("voices_identity_test")
    rostest.rosrun("hri_pipeline", "voices_identity", VoicesIdentityTest)
