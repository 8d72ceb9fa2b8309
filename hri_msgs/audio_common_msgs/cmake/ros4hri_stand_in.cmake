# Its presence tells hri_msgs that this audio_common_msgs is its own stand-in, not a released package.
