"""From sound to voices: stream, microphone array, localisation, separation, voice activity, turns, features."""
