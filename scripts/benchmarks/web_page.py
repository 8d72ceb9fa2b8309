"""How long a browser waits for the first picture of the web page, beside the whole stack on the demonstration pictures.

As a program: `python3 -m benchmarks.web_page FILE`, on the master of a stack; web_figures starts both.
"""

from __future__ import annotations

import json
import re
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Dict, List

import rosgraph
import rospy

from benchmarks.stack_run import measure_alone

TIMES = 7
WAIT_S = 60.0
_SHOWN = "Number(document.getElementById('picture')?.dataset.shown || 0) / 1000"


def web_figures() -> Dict[str, object]:
    """Return the longest and the median time (s) from the call of the page to its first picture.

    Each time nobody has looked before: the overlay is not drawn yet.
    """
    found = measure_alone("web", "web_page", patience=300.0, launch=["ros4hri", "demo.launch", "rviz:=false"])
    times = found["times_s"]
    return {"web_first_picture_s": round(max(times), 2),
            "web_first_picture_median_s": round(statistics.median(times), 2)}


def first_pictures(url: str) -> List[float]:
    """Open the page TIMES times; return the times to the first picture, s."""
    from hri_pipeline.testing import Browser, wait_for
    browser, times = Browser(), []
    try:
        for _ in range(TIMES):
            browser.open(url)
            times.append(float(wait_for(lambda: browser.value(_SHOWN), WAIT_S, "a picture", period=0.05)))
            browser.open("about:blank")
            wait_for(lambda: not _looks(), WAIT_S, "nobody looks at the overlay", period=0.1)
    finally:
        browser.close()
    return times


def _looks() -> bool:
    """Whether the page subscribes to the overlay."""
    return any(topic == "/visualization/overlay" and "/hri_web" in nodes
               for topic, nodes in rosgraph.Master("/web_page").getSystemState()[1])


def main() -> int:
    """Start the page, measure, and write one JSON object."""
    from hri_msgs.msg import IdsList
    rospy.init_node("web_page")
    while not getattr(rospy.wait_for_message("/humans/persons/tracked", IdsList, WAIT_S), "ids", ()):
        pass
    node = subprocess.Popen(["rosrun", "hri_person_manager", "web", "_port:=0"], stdout=subprocess.PIPE,
                            universal_newlines=True)
    try:
        said = (re.search(r"the page is at (http://\S+)", line) for line in node.stdout or ())
        times = first_pictures(next(found.group(1) for found in said if found))
    finally:
        node.terminate()
        node.communicate(timeout=WAIT_S)
    Path(sys.argv[1]).write_text(json.dumps({"times_s": times}), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
