"""python -m hri_pipeline.models: the same as rosrun hri_pipeline fetch_models, without a ROS workspace."""

from __future__ import annotations

import sys

from hri_pipeline.models.command import main

if __name__ == "__main__":
    sys.exit(main())
