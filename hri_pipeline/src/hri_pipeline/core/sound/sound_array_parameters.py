"""Parameters of direction and separation, part of the table of the node `voices`."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter

SOUND_ARRAY_PARAMETERS = (
    Parameter("microphone_positions", [], "Where the microphones are, one text \"x y z\" per channel, in the microphone frame (x"
              " forward, y left, z up): [\"0.04 0.04 0\", \"-0.04 0.04 0\", \"-0.04 -0.04 0\", \"0.04 -0.04 0\"]. Errors of some"
              " millimetres cost some degrees. Empty: there is no array, the channels are mixed to one.", unit="m"),
    Parameter("line_front", True, "Microphones on one line, two of them above all, tell only the angle against the line. True:"
              " voices are taken to be in front of it. False: their direction is not told; they are separated all the same."),
    Parameter("max_sources", 4, "Directions that are listened to at a time, at most. Each costs as much as the first search for"
              " directions.", minimum=1, maximum=8),
    Parameter("source_birth_time", 0.1, "Time over which a new direction must sound before it is listened to. Its voice is not cut:"
              " what was said meanwhile is kept. Longer: fewer echoes and slammed doors.", unit="s", minimum=0.0, maximum=1.0),
    Parameter("source_look_back", 0.3, "What is kept of the sound before a direction is listened to.", unit="s", minimum=0.0,
              maximum=1.0),
    Parameter("source_hold_time", 1.0, "Time for which a direction that has fallen silent is still listened to. It must be longer"
              " than the pause that ends a turn (hangover_time).", unit="s", minimum=0.1, maximum=10.0, live=True),
    Parameter("source_memory", 10.0, "Time for which a silent direction is remembered. A voice from there is the same as"
              " before, later it is a new one.", unit="s", minimum=0.5, maximum=600.0),
)
