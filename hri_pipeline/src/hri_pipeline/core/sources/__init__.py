"""Where images and sound come from when no robot sends them: files, directories, cameras, microphones."""
