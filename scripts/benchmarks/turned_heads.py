"""Head pose against a known turn: faces of photographs, lifted to solid heads by their mesh, turned and seen anew.

The truth is the turn against how the same head is told ahead: what a face's own shape adds to its pose in every view
is not seen. A head is a mesh with depth and a smooth shell with the hair and ears of the photograph behind it; up to
some 50 degrees such views pass for real, beyond they show smeared skin and hair, and the mesh takes that for a face
(TURN). Such a head's own points, without any network, give a turn of 20 to 35 degrees 2 degrees too small: its relief
is the network's guess, so that a bias of that size says nothing of real heads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Sequence, Tuple

import cv2
import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from benchmarks.face_figures import GEOMETRY_ONLY, PHOTOGRAPH_HFOV, read_image
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.head_pose import HeadPoseEstimator, yaw_pitch_roll
from hri_pipeline.core.faces.mesh import VERTICES, CanonicalFace, FaceMesh, load_canonical_face, roi_from_mesh
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import head_direction_sd
from hri_pipeline.core.onnx import OnnxModel, models_directory

PICTURES = ("demo/sample3.jpg", "demo/sample5.jpg", "demo/sample6.jpg", "evaluation/five.jpg", "evaluation/group.jpg",
            "evaluation/laugh.jpg", "evaluation/portrait_01.jpg", "evaluation/portrait_02.jpg",
            "evaluation/portrait_03.jpg", "evaluation/portrait_04.jpg", "evaluation/portrait_05.jpg",
            "evaluation/portrait_07.jpg", "evaluation/posed_angry.jpg", "evaluation/posed_happy.jpg",
            "evaluation/posed_surprised.jpg", "evaluation/recognition/one_1.jpg", "evaluation/talking_02.jpg")
"""One picture of each person."""
SCENE = "evaluation/outdoors.jpg"
FRONTAL, LEAST_WIDTH = np.deg2rad((18.0, 25.0, 25.0)), 90.0
"""Yaw, pitch, roll (rad) up to which a face is lifted, and its least width (px)."""
TURN = 50.0
"""Turn (degrees) away from the camera up to which views count."""
YAW, PITCH, ROLL = 50.0, 35.0, 30.0
WIDTHS = (24, 34, 48, 70, 110, 200)
"""Widths (px) of the heads in the views."""
WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
FACE_M = 0.145
_OVAL = np.array([10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148,
                  176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109])
"""Vertices round the face."""
_SIDES, _TOP, _CHIN = (234, 454), 10, 152
_SHELL = ((1.06, 1.10, 0.12), (1.11, 1.22, 0.32), (1.13, 1.34, 0.60), (1.12, 1.40, 0.95), (1.06, 1.38, 1.30),
          (0.90, 1.20, 1.65), (0.6, 0.8, 1.95), (0.2, 0.25, 2.08))
"""Rings behind the face: size over the oval's at the sides and at the top, and depth in half widths."""
_NOISE = 2.5
_AHEAD = ((0.0, 0.0), (8.0, 0.0), (-8.0, 0.0), (0.0, 8.0), (0.0, -8.0))
_AHEAD_WIDTH = 170


class Solid(NamedTuple):
    """A head: points (N, 3) m about its middle, in the axes of the optical frame; texture (N, 2) px of `image`;
    triangles (T, 3); width of the face, px of `image`; middle (2,) px."""

    image: np.ndarray
    points: np.ndarray
    texture: np.ndarray
    triangles: np.ndarray
    width: float
    middle: np.ndarray


class View(NamedTuple):
    """Errors (degrees) of one view: to the sides, up, roll; its width (px), told turn away from the camera, and the
    standard deviation that is said of the direction (degrees)."""

    errors: np.ndarray
    width: int
    turn: float
    said: float


def lift(image: np.ndarray, mesh: np.ndarray, canonical: CanonicalFace) -> Solid:
    """Return the head of a face that looks ahead; mesh: (478, 3) px."""
    image, face = _cut(image, mesh[:VERTICES])
    right = face[_SIDES[1]] - face[_SIDES[0]]
    width = float(np.linalg.norm(right))
    right = right / width
    down = face[_CHIN] - face[_TOP]
    down = down - right * (down @ right)
    axes = np.stack([right, down / np.linalg.norm(down), np.cross(right, down / np.linalg.norm(down))])
    middle = 0.5 * (face[_SIDES[0]] + face[_SIDES[1]])
    rings, textures = _shell((face[_OVAL] - middle) @ axes.T, width)
    points = np.concatenate([face] + [middle + ring @ axes for ring in rings])
    texture = np.concatenate([face] + [middle + ring @ axes for ring in textures])[:, :2]
    centre = middle + 0.15 * width * axes[2]
    return Solid(image, (points - centre) * FACE_M / width, texture, _triangles(canonical), width, centre[:2])


def _cut(image: np.ndarray, face: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """The picture round a face (468, 3) px, the face at most WIDTHS[-1] px wide, and its points there."""
    width = float(np.ptp(face[:, 0]))
    low = np.maximum(face[:, :2].mean(axis=0) - 2.2 * width, 0.0).astype(int)
    high = (face[:, :2].mean(axis=0) + 2.2 * width).astype(int)
    part, scale = image[low[1]:high[1], low[0]:high[0]], min(1.0, WIDTHS[-1] / width)
    return (cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA),
            (face - np.append(low, 0.0)) * scale)


def _shell(oval: np.ndarray, width: float) -> Tuple[List[np.ndarray], List[np.ndarray]]:
    """Rings (36, 3) px behind the oval (36, 3) in the head's axes, and where in the photograph each looks like."""
    middle = float(oval[:, 1].mean())
    height = (oval[:, 1] - middle) / np.abs(oval[:, 1] - middle).max()
    top, chin = np.maximum(-height, 0.0), np.maximum(height, 0.0)
    rings, textures, widest = [], [], np.ones(len(oval))
    for side, above, depth in _SHELL:
        size = side + (above - side) * top
        size = np.where(chin > 0.35, 1.0 + (size - 1.0) * ((1.0 - chin) / 0.65).clip(0.0, 1.0) ** 0.7, size)
        flat = min(depth / 1.2, 1.0)
        ring = np.stack([oval[:, 0] * size,
                         middle + (oval[:, 1] - middle) * size - 0.125 * width * chin * min(max(depth - 0.3, 0.0), 1.2),
                         (1.0 - flat) * (oval[:, 2] + 0.5 * depth * width)
                         + flat * (oval[:, 2].mean() + 0.5 * depth * width)], axis=1)
        widest = np.maximum(widest, size)
        seen = np.where(chin > 0.35, np.maximum(widest, 1.0 + 0.12 * min(depth / 0.6, 1.0)), widest)
        rings.append(ring)
        textures.append(np.stack([oval[:, 0] * seen, middle + (oval[:, 1] - middle) * seen, oval[:, 2]], axis=1))
    return rings, textures


def _triangles(canonical: CanonicalFace) -> np.ndarray:
    """(T, 3) of the face, unrolled about the head's axis, and of the rings behind it."""
    x, y, z = canonical.vertices.T
    flat = np.stack([0.08 * np.arctan2(x, z.max() + 0.02 - z), y], axis=1)
    inside = Delaunay(flat).simplices
    outline = flat[_OVAL].astype(np.float32)
    inside = inside[[cv2.pointPolygonTest(outline, tuple(flat[one].mean(axis=0).tolist()), False) >= 0
                     for one in inside]]
    found, ring = [inside], _OVAL
    for number in range(len(_SHELL)):
        after = VERTICES + number * len(_OVAL) + np.arange(len(_OVAL))
        found += [np.stack([ring, np.roll(ring, -1), after], axis=1),
                  np.stack([np.roll(ring, -1), np.roll(after, -1), after], axis=1)]
        ring = after
    return np.concatenate(found)


def draw(head: Solid, rotation: np.ndarray, width: int, scene: np.ndarray, random: np.random.RandomState
         ) -> np.ndarray:
    """Return the view (480, 640, 3) of a head, turned (3, 3), `width` px wide, before its photograph and `scene`."""
    placed = head.points @ rotation.T + np.array([0.0, 0.0, FACE_M * FOCAL / width])
    finer = 1 if width >= 110 else 2
    pixels = (placed[:, :2] / placed[:, 2:] * FOCAL + (WIDTH / 2.0, HEIGHT / 2.0)) * finer
    texture, covered = _seen(pixels, 1.0 / placed[:, 2], head, (WIDTH * finer, HEIGHT * finer))
    scale = min(1.0, width * finer / head.width)
    small = cv2.resize(head.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    places = ((texture + 0.5) * scale - 0.5).astype(np.float32)
    colours = cv2.remap(small, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = cv2.resize(colours * covered[..., None], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    covered = cv2.resize(covered, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[..., None]
    image = _behind(head, width, scene) * (1.0 - covered) + colours
    return np.clip(image + random.normal(0.0, _NOISE, image.shape), 0.0, 255.0).astype(np.uint8)


def _seen(pixels: np.ndarray, nearness: np.ndarray, head: Solid, size: Tuple[int, int]
          ) -> Tuple[np.ndarray, np.ndarray]:
    """Texture place (H, W, 2) of the nearest triangle in each pixel, and where there is one (H, W) float32."""
    width, height = size
    corners = pixels[head.triangles]
    low = np.clip(np.floor(corners.min(axis=1)), 0, size).astype(int)
    spans = np.clip(np.ceil(corners.max(axis=1)) + 1, 0, size).astype(int) - low
    counts = spans[:, 0] * spans[:, 1]
    which = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    at = low[which] + np.stack([step % spans[which, 0], step // spans[which, 0]], axis=1)
    first, second, third = corners[which].transpose(1, 0, 2)
    shares = np.stack([_cross(second - at - 0.5, third - at - 0.5), _cross(third - at - 0.5, first - at - 0.5),
                       _cross(first - at - 0.5, second - at - 0.5)], axis=1)
    area = shares.sum(axis=1, keepdims=True)
    shares = shares / np.where(np.abs(area) < 1e-9, 1e-9, area)
    good = (shares >= -1e-3).all(axis=1)
    vertices = head.triangles[which[good]]
    weights = shares[good] * nearness[vertices]
    total = weights.sum(axis=1)
    order = np.argsort(total, kind="stable")        # the nearest is written last
    nearest = np.full(width * height, -1)
    nearest[(at[good, 1] * width + at[good, 0])[order]] = order
    texture, known = np.zeros((width * height, 2)), nearest >= 0
    chosen = nearest[known]
    texture[known] = (head.texture[vertices[chosen]] * (weights / total[:, None])[chosen][..., None]).sum(axis=1)
    return texture.reshape(height, width, 2), known.reshape(height, width).astype(np.float32)


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def _behind(head: Solid, width: int, scene: np.ndarray) -> np.ndarray:
    """The scene (480, 640, 3) with the photograph round the head in it, its head painted out."""
    scale, side = width / head.width, int(3.4 * width)
    place = np.array([[scale, 0.0, side / 2 - scale * head.middle[0]], [0.0, scale, side / 2 - scale * head.middle[1]]])
    photograph = cv2.warpAffine(cv2.GaussianBlur(head.image, (0, 0), max(0.3, 0.4 / scale)), place, (side, side),
                                borderMode=cv2.BORDER_REPLICATE)
    mask = np.zeros((side, side), np.uint8)
    outline = cv2.convexHull(head.texture.astype(np.float32))[:, 0] @ place[:, :2].T + place[:, 2]
    cv2.fillConvexPoly(mask, outline.astype(np.int32), 255)
    tiny = cv2.inpaint(cv2.resize(photograph, (100, 100)), cv2.resize(mask, (100, 100)), 3, cv2.INPAINT_TELEA)
    photograph = np.where(mask[..., None] > 0, cv2.resize(tiny, (side, side)), photograph)
    ramp = np.minimum(np.arange(side), np.arange(side)[::-1]) / (0.12 * side)
    share = np.minimum(np.minimum(ramp[:, None], ramp[None]), 1.0)[..., None]
    image = scene.astype(np.float64)
    left, above = (WIDTH - side) // 2, (HEIGHT - side) // 2
    rows, columns = slice(max(above, 0), above + side), slice(max(left, 0), left + side)
    inner = (slice(max(-above, 0), max(-above, 0) + HEIGHT), slice(max(-left, 0), max(-left, 0) + WIDTH))
    image[rows, columns] += share[inner] * (photograph[inner] - image[rows, columns])
    return image


class Observer:
    """Tells the pose of a head in a view as the face stage does of a face it follows."""

    def __init__(self, canonical: CanonicalFace) -> None:
        self._mesh = FaceMesh(OnnxModel(models_directory() / "face_landmarks_attention.onnx"))
        self._heads = HeadPoseEstimator(canonical)
        self._camera = CameraModel.from_fov(WIDTH, HEIGHT, 2.0 * np.arctan2(0.5 * WIDTH, FOCAL))

    def __call__(self, head: Solid, rotation: np.ndarray, width: int, scene: np.ndarray,
                 random: np.random.RandomState) -> Tuple[np.ndarray, float]:
        """Return the rotation (3, 3) of the face frame, and the turn (degrees) away from the camera; NaN without."""
        image = draw(head, rotation, width, scene, random)
        placed = head.points[:VERTICES] @ rotation.T + np.array([0.0, 0.0, FACE_M * FOCAL / width])
        points = placed[:, :2] / placed[:, 2:] * FOCAL + (WIDTH / 2.0, HEIGHT / 2.0)
        points = points + random.normal(0.0, 0.03 * width, 2)
        for _ in range(3):
            points = self._mesh.run(image, [roi_from_mesh(points)])[0].points
        pose = self._heads.estimate(points, self._camera)
        if pose is None:
            return np.full((3, 3), np.nan), np.nan
        line = pose.translation / np.linalg.norm(pose.translation)
        return pose.rotation, float(np.degrees(np.arccos(np.clip(-line @ pose.rotation[:, 0], -1.0, 1.0))))


def views_of(head: Solid, observe: Observer, scene: np.ndarray, count: int, random: np.random.RandomState
             ) -> Iterator[View]:
    """Yield the errors of `count` drawn turns at each of three widths."""
    settings = INTERACTION_PARAMETERS.resolve({})
    turns = [_turn(yaw, pitch, 0.0) for yaw, pitch in _AHEAD]
    told = [turn.T @ observe(head, turn, _AHEAD_WIDTH, scene, random)[0] for turn in turns]
    left, _, right = np.linalg.svd(np.mean(told, axis=0))
    ahead = left @ right
    for number in range(count):
        yaw = YAW * (2.0 * (number + random.rand()) / count - 1.0)
        turn = _turn(yaw, random.uniform(-PITCH, PITCH), random.uniform(-ROLL, ROLL))
        truth = turn @ ahead
        for width in WIDTHS[number % 2::2]:
            rotation, away = observe(head, turn, width, scene, random)
            if -truth[2, 0] >= np.cos(np.deg2rad(TURN)):
                said = head_direction_sd(settings, np.deg2rad(away))
                yield View(direction_errors(rotation, truth), width, away, float(np.degrees(said)))


def direction_errors(rotation: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return how far a face frame (3, 3) points too far to the image's right and up, and its roll about where it points
    (3,) degrees."""
    (bearing, height), (true_bearing, true_height) = ((np.arctan2(x, -z), np.arcsin(np.clip(-y, -1.0, 1.0)))
                                                      for x, y, z in (rotation[:, 0], truth[:, 0]))
    sides = (bearing - true_bearing + np.pi) % (2.0 * np.pi) - np.pi
    roll = -Rotation.from_matrix(rotation @ truth.T).as_rotvec() @ truth[:, 0]
    return np.degrees([sides * np.sqrt(np.cos(height) * np.cos(true_height)), height - true_height, roll])


def _turn(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Rotation (3, 3) of a head in the optical frame (degrees), signs as of yaw_pitch_roll."""
    return Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()


def people(models: Path, canonical: CanonicalFace) -> Iterator[Solid]:
    """Yield the heads of everybody in PICTURES whose face looks ahead and is large enough."""
    stage = FacePipeline(FACES.resolve(dict(GEOMETRY_ONLY, face_birth_delay=0.0, face_min_detections=1,
                                            face_person_lead=0.0)))
    for file in PICTURES:
        image = read_image(models / file)
        scale = min(1.0, 1280.0 / max(image.shape[:2]))
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        stage.reset()
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)
        for face in stage.update(image, camera, 1000.0):
            if face.pose is None or np.ptp(face.mesh[:, 0]) < LEAST_WIDTH:
                continue
            x, _, z = face.pose.translation
            if (np.abs(yaw_pitch_roll(face.pose) + [np.arctan2(x, z), 0.0, 0.0]) <= FRONTAL).all():
                yield lift(image, face.mesh, canonical)
    stage.close()


def figures(models: Path, count: int = 4) -> Dict[str, object]:
    """Return errors (degrees, root mean square) to the sides and up, and the squares of errors over what is said (1 is
    right), by the turn that is told and by width; `heads`: how many; `without`: views without a pose."""
    canonical = load_canonical_face(models / "canonical_face.npz")
    observe, heads = Observer(canonical), 0
    views: List[View] = []
    scene = cv2.resize(read_image(models / SCENE), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)[:, ::-1]
    for head in people(models, canonical):
        views += views_of(head, observe, scene, count, np.random.RandomState(heads))
        heads += 1
    told = [view for view in views if np.isfinite(view.turn)]
    bins = [("turn {:.0f} to {:.0f}".format(low, low + 15.0), [view for view in told if low <= view.turn < low + 15.0])
            for low in (0.0, 15.0, 30.0)]
    bins += [("{} px".format(width), [view for view in told if view.width == width]) for width in WIDTHS]
    found: Dict[str, object] = {name: _summary(group) for name, group in bins if group}
    return dict(found, heads=heads, without=len(views) - len(told))


def _summary(views: Sequence[View]) -> Dict[str, float]:
    errors = np.array([view.errors for view in views])
    said = np.array([[view.said] for view in views])
    squares = (errors / said) ** 2
    sides, up, _ = np.sqrt((errors ** 2).mean(axis=0)).round(1).tolist()
    sides_squares, up_squares, _ = squares.mean(axis=0).round(2).tolist()
    return {"views": len(views), "said_deg": round(float(np.sqrt((said ** 2).mean())), 1), "sides_deg": sides,
            "up_deg": up, "sides_squares": sides_squares, "up_squares": up_squares}
