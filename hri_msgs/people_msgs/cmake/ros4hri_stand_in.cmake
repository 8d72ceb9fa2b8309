# Its presence tells hri_msgs that this people_msgs is its own stand-in, not a released package.
