"""Parameters of the sample_conversation node."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, parameter


@dataclass(frozen=True)
class SampleConversationSettings(Settings):
    """Plays a simulated conversation: faces with moving mouths, voices, and where they are."""

    people: int = parameter(3, "Number of people in view.", minimum=1, maximum=10)
    directions: bool = parameter(
        True, "The voices have directions, with an error of 10 degrees, as of an array. Off: one microphone.")
    unseen_share: float = parameter(
        0.2, "Part of the turns that comes from somebody out of view.", minimum=0.0, maximum=1.0)
    seed: int = parameter(0, "Another number: another conversation.", minimum=0, maximum=1000000)


SAMPLE_CONVERSATION_PARAMETERS = ParameterTable("sample_conversation", SampleConversationSettings)
