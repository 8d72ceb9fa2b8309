"""The URDF of one human as text: links, joints and visuals; no inertia, no meshes, no xacro.

The visuals are spheres and cylinders: urdfdom has no capsules, and no mesh file has to be found. Their sizes are shares
of the stature, or of the segment that they cover. Places are in the axes of the link: x forward, y to the left, z to
the head; limbs point to -z. `main` is the command make_human_urdf.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Tuple
from xml.sax.saxutils import quoteattr

from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import PAPER, SEGMENTS, Dimensions, Layout, layout_for
from hri_pipeline.core.ids import ID_PATTERN, is_valid_id

Point = Tuple[float, float, float]

MATERIALS: Dict[str, Tuple[float, float, float]] = {
    "skin": (0.87, 0.66, 0.53), "hair": (0.23, 0.15, 0.10), "white": (0.95, 0.95, 0.95), "pupil": (0.10, 0.10, 0.14),
    "shirt": (0.30, 0.52, 0.70), "trousers": (0.27, 0.30, 0.38), "shoes": (0.24, 0.19, 0.16),
}
# Balls of the head about the sellion, m at a stature of 1.70 m: x, y, z, radius, material; y is mirrored where it is
# not 0.
_HEAD = (
    (-0.086, 0.0, 0.026, 0.077, "skin"), (-0.074, 0.0, -0.024, 0.069, "skin"), (-0.058, 0.0, -0.066, 0.052, "skin"),
    (-0.094, 0.0, 0.037, 0.079, "hair"), (-0.114, 0.0, -0.008, 0.072, "hair"), (0.0, 0.0, -0.036, 0.014, "skin"),
    (-0.0155, 0.0315, 0.0, 0.0125, "white"), (-0.007, 0.031, 0.0, 0.0058, "pupil"))
# Rods of the torso from side to side: share of the trunk's length above the hips, half width (share of the half
# shoulders), radius (share of the stature).
_TORSO = ((0.25, 0.39, 0.056), (0.50, 0.42, 0.059), (0.72, 0.54, 0.063), (0.90, 0.68, 0.050), (1.0, 1.0, 0.034))


class Shape(NamedTuple):
    """A sphere, or a cylinder if `length` is more than 0: its axis is z turned by pitch, then yaw (rad). m."""

    place: Point
    radius: float
    material: str
    length: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0


def _rod(a: Point, b: Point, radius: float, material: str) -> Shape:
    """A cylinder from a to b."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    across = math.hypot(dx, dy)
    middle = (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))
    return Shape(middle, radius, material, math.hypot(across, dz), math.atan2(across, dz), math.atan2(dy, dx))


def _capsule(a: Point, b: Point, radius: float, material: str) -> List[Shape]:
    """A rod with round ends."""
    return [Shape(a, radius, material), _rod(a, b, radius, material), Shape(b, radius, material)]


def _limb(length: float, upper: float, lower: float, material: str) -> List[Shape]:
    """A tapered limb along -z with round ends; upper, lower: its radii, m."""
    cuts = [(0.0, 0.0, -length * share / 3.0) for share in range(4)]
    shapes = [_rod(a, b, upper + (lower - upper) * (2 * n + 1) / 6.0, material)
              for n, (a, b) in enumerate(zip(cuts, cuts[1:]))]
    return shapes + [Shape(cuts[0], upper, material), Shape(cuts[-1], lower, material)]


def body_shapes(dimensions: Dimensions) -> Dict[str, Tuple[Shape, ...]]:
    """Shapes of each link that has any, by the link's name without the body's id."""
    h, hips, shoulders = dimensions.stature, dimensions.half_hips, dimensions.half_shoulders
    floor, scale = -dimensions.ankle_height, h / 1.70
    torso = [_rod((-0.002 * h, 0.0, 0.0), (0.010 * h, 0.0, 0.085 * h), 0.0315 * h, "skin")]
    for share, reach, radius in _TORSO:
        end, z = reach * shoulders, (share - 1.0) * dimensions.trunk
        torso += _capsule((0.0, end, z), (0.0, -end, z), radius * h, "shirt")
    shapes: Dict[str, List[Shape]] = {
        "body": [shape for z in (-0.012 * h, 0.045 * h)
                 for shape in _capsule((0.0, 0.88 * hips, z), (0.0, -0.88 * hips, z), 0.056 * h, "trousers")],
        "torso": torso,
        "head": [Shape((x * scale, sign * y * scale, z * scale), radius * scale, material)
                 for x, y, z, radius, material in _HEAD for sign in ((1.0, -1.0) if y else (1.0,))]}
    for side, sign in _SIDES:
        toes = (0.095 * h, 0.0, floor + 0.0185 * h)
        shapes[side + "shoulder"] = _limb(dimensions.upper_arm, 0.036 * h, 0.0235 * h, "shirt")
        shapes[side + "elbow"] = _limb(dimensions.forearm, 0.0245 * h, 0.0155 * h, "skin")
        shapes[side + "wrist"] = _capsule(
            (0.0, 0.0, -0.02 * h), (0.0, -0.005 * h * sign, -0.085 * h), 0.0175 * h, "skin")
        shapes[side + "hip"] = _limb(dimensions.thigh, 0.052 * h, 0.033 * h, "trousers")
        shapes[side + "knee"] = _limb(dimensions.shank, 0.034 * h, 0.024 * h, "trousers")
        shapes[side + "ankle"] = [
            Shape((-0.022 * h, 0.0, floor + 0.022 * h), 0.022 * h, "shoes"), Shape(toes, 0.0185 * h, "shoes"),
            _rod((-0.022 * h, 0.0, floor + 0.020 * h), toes, 0.0185 * h, "shoes"),
            *_capsule((0.0, 0.0, 0.0), (0.045 * h, 0.0, floor + 0.025 * h), 0.0215 * h, "shoes")]
    return {name: tuple(parts) for name, parts in shapes.items()}


_HEADER = '<?xml version="1.0"?>\n<robot name={}>\n'
_MATERIAL = '<material name="{}"><color rgba="{:g} {:g} {:g} 1"/></material>\n'
_JOINT = ('<joint name="{name}_{id}" type="{type}"><parent link="{parent}_{id}"/><child link="{child}_{id}"/>'
          '<origin xyz="{x:.9g} {y:.9g} {z:.9g}" rpy="0 0 0"/>{motion}</joint>\n')
_MOTION = '<axis xyz="{:g} {:g} {:g}"/><limit lower="{:.6g}" upper="{:.6g}" effort="1000" velocity="20"/>'
_SPHERE = ('<visual><origin xyz="%.4f %.4f %.4f"/><geometry><sphere radius="%.4f"/></geometry>'
           '<material name="%s"/></visual>')
_CYLINDER = ('<visual><origin xyz="%.4f %.4f %.4f" rpy="0 %.4f %.4f"/><geometry><cylinder radius="%.4f" length="%.4f"/>'
             '</geometry><material name="%s"/></visual>')
_SIDES = (("l_", 1.0), ("r_", -1.0))


def make_urdf(dimensions: Dimensions, body_id: str, layout: Layout = PAPER, visuals: bool = True,
              stature_sd: Optional[float] = None) -> str:
    """Make the URDF of a body; every link and joint name ends in `_ID`.

    stature_sd: standard deviation of the stature, m; None: it is the average, or given. It is told in a comment.
    Raises ValueError for an id that does not match `ID_PATTERN`. Takes about half a millisecond.
    """
    if not is_valid_id(body_id):
        raise ValueError("body id {!r} is not legal; it must match {}".format(body_id, ID_PATTERN))
    shapes = body_shapes(dimensions) if visuals else {}
    parts = [_HEADER.format(quoteattr("human_" + body_id))]
    parts.append("<!-- stature_m: {:.3f} stature_sd_m: {} -->\n".format(
        dimensions.stature, "unknown" if stature_sd is None else "{:.3f}".format(stature_sd)))
    if visuals:
        parts += [_MATERIAL.format(name, *colour) for name, colour in MATERIALS.items()]
    parts += ['<link name="{}_{}">{}</link>\n'.format(name, body_id, _visual_text(shapes.get(name, ())))
              for name in link_names(layout)]
    places = _joint_places(dimensions, layout)
    for joint in layout.joints:
        motion = _MOTION.format(*joint.axis, joint.lower, joint.upper)
        parts.append(_joint_text(joint.name, body_id, joint.parent, joint.child, places[joint.name], motion))
    for name, parent, place in _fixed_joints(dimensions):
        parts.append(_joint_text(name, body_id, parent, name, place, ""))
    parts.append("</robot>\n")
    return "".join(parts)


def link_names(layout: Layout = PAPER) -> List[str]:
    """Names of all links without the body's id, the root `body` first."""
    names = ["body"] + [joint.child for joint in layout.joints] + ["torso", "head"]
    return names + [side + end for side, _ in _SIDES for end in ("wrist", "ankle")]


def _joint_text(name: str, body_id: str, parent: str, child: str, place: Tuple[float, float, float],
                motion: str) -> str:
    return _JOINT.format(name=name, id=body_id, type="revolute" if motion else "fixed", parent=parent, child=child,
                         x=place[0], y=place[1], z=place[2], motion=motion)


def _joint_places(dimensions: Dimensions, layout: Layout) -> Dict[str, Tuple[float, float, float]]:
    """Origin (m, in the parent's axes) of each moving joint."""
    places = {joint.name: (0.0, 0.0, 0.0) for joint in layout.joints}
    places["r_head"] = (0.0, 0.0, dimensions.neck_pivot)
    for side, sign in _SIDES:
        first_hip = next(joint.name for joint in layout.joints if joint.parent == "body" and joint.name[:2] == side)
        places[first_hip] = (0.0, sign * dimensions.half_hips, 0.0)
        places[side + "y_shoulder"] = (0.0, sign * dimensions.half_shoulders, 0.0)
        places[side + "elbow"] = (0.0, 0.0, -dimensions.upper_arm)
        places[side + "knee"] = (0.0, 0.0, -dimensions.thigh)
    return places


def _fixed_joints(dimensions: Dimensions) -> List[Tuple[str, str, Tuple[float, float, float]]]:
    """Name (also of the child), parent and origin (m) of each fixed joint."""
    x, y, z = dimensions.head_offset.tolist()
    joints = [("torso", "waist", (0.0, 0.0, dimensions.trunk)), ("head", "p_head", (x, y, z))]
    for side, _ in _SIDES:
        joints.append((side + "wrist", side + "elbow", (0.0, 0.0, -dimensions.forearm)))
        joints.append((side + "ankle", side + "knee", (0.0, 0.0, -dimensions.shank)))
    return joints


def _visual_text(shapes: Tuple[Shape, ...]) -> str:
    """Visual elements of one link."""
    return "".join(
        _SPHERE % (shape.place + (shape.radius, shape.material)) if shape.length == 0.0 else
        _CYLINDER % (shape.place + (shape.pitch, shape.yaw, shape.radius, shape.length, shape.material))
        for shape in shapes)


_DESCRIPTION = "Make the URDF of a human, as the stack makes it for each body that it sees."


def parse(argv: Optional[List[str]]) -> argparse.Namespace:
    """Read the command line; ends the process with the usage when it is wrong."""
    parser = argparse.ArgumentParser(prog="make_human_urdf", description=_DESCRIPTION)
    parser.add_argument("--height", type=float, default=1.70, help="stature, m (default: 1.70)")
    parser.add_argument("--id", required=True, help="id of the body: every link and joint ends in _ID")
    parser.add_argument("--interface", default="paper", choices=("paper", "rep155"),
                        help="paper: 18 joints, two in each hip; rep155: 20, three in each hip (default: paper)")
    parser.add_argument("--segments", default="", help="file with the proportions (default: the package's own)")
    parser.add_argument("--length", action="append", default=[], metavar="SEGMENT=M",
                        help="known length of a segment in m, such as upper_arm=0.29; may be given again. Segments: "
                             + ", ".join(SEGMENTS))
    parser.add_argument("--no-visuals", action="store_true", help="links and joints only")
    parser.add_argument("--output", default="-", help="file to write; - is standard output (default: -)")
    return parser.parse_args(argv)


def main(argv: Optional[List[str]] = None) -> int:
    """Write the URDF; return 0, or 1 after telling on standard error what is wrong."""
    arguments = parse(argv)
    try:
        table = SegmentTable.load(arguments.segments)
        dimensions = Dimensions.from_segments(arguments.height, _lengths(arguments.length), table)
        text = make_urdf(dimensions, arguments.id, layout_for(arguments.interface), not arguments.no_visuals)
        if arguments.output == "-":
            sys.stdout.write(text)
        else:
            Path(arguments.output).write_text(text, encoding="utf-8")
    except (ValueError, OSError) as error:
        sys.stderr.write("make_human_urdf: {}\n".format(error))
        return 1
    return 0


def _lengths(items: List[str]) -> dict:
    """Lengths (m) by name of the options SEGMENT=M. Raises ValueError naming the option."""
    lengths = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            lengths[name] = float(value)
        except ValueError:
            raise ValueError("--length {}: expected SEGMENT=M, such as upper_arm=0.29".format(item)) from None
    return lengths
