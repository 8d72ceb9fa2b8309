import numpy as np
import pytest

from hri_pipeline.core.depth import depth_from_raw, sample_depth
from hri_pipeline.core.images import ImageError

MILLIMETRES = np.array([[0, 500, 1500], [2345, 65535, 30001]], np.uint16)
METRES = np.array([[np.nan, 0.5, 1.5], [2.345, np.inf, -1.0]], np.float32)
WANTED = np.array([[np.nan, 0.5, 1.5], [2.345, np.nan, np.nan]])


def raw(values, big=False, padding=0):
    """Bytes and step of a depth image, as a driver sends it."""
    rows = values.astype(values.dtype.newbyteorder(">" if big else "<"))
    return b"".join(row.tobytes() + b"\x7f" * padding for row in rows), rows.shape[1] * rows.itemsize + padding


@pytest.mark.parametrize("big", [False, True], ids=["little", "big"])
@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("values, encoding", [(MILLIMETRES, "16UC1"), (MILLIMETRES, "mono16"), (METRES, "32FC1")])
def test_every_way_to_write_it_gives_metres(values, encoding, padding, big):
    data, step = raw(values, big, padding)
    depth = depth_from_raw(data, 3, 2, step, encoding, big)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, WANTED, atol=1e-6)


def test_the_last_row_needs_no_padding():
    data, step = raw(MILLIMETRES, padding=4)
    np.testing.assert_allclose(depth_from_raw(data[:-4], 3, 2, step, "16UC1"), WANTED, atol=1e-6)


@pytest.mark.parametrize("change, text", [
    (dict(encoding="rgb8"), "encoding 'rgb8'"), (dict(width=0), "0x2"), (dict(height=9000), "9000"),
    (dict(step=5), "step is 5"), (dict(data=b"\0" * 11), "too short"), (dict(encoding="32FC1"), "step is 6")])
def test_what_cannot_be_read_is_told(change, text):
    data, step = raw(MILLIMETRES)
    fields = dict(data=data, width=3, height=2, step=step, encoding="16UC1")
    fields.update(change)
    with pytest.raises(ImageError, match=text):
        depth_from_raw(**fields)


def test_the_median_forgives_holes_and_flying_pixels():
    depth = np.full((20, 30), 2.0, np.float32)
    depth[10, 10], depth[10, 11], depth[9, 9] = np.nan, 0.0, 7.0
    assert sample_depth(depth, np.array([[10.5, 10.5]]), 30, 20) == pytest.approx([2.0])


def test_too_few_known_cells_and_points_outside_give_nan():
    depth = np.full((20, 30), np.nan, np.float32)
    depth[5, 5:7] = 2.0
    depth[12, 12:15] = 2.0
    points = np.array([[5.5, 5.5], [13.5, 12.5], [-0.5, 3.0], [30.0, 3.0], [3.0, 20.5], [np.nan, 3.0], [1e9, 1.0]])
    found = sample_depth(depth, points, 30, 20)
    assert found[1] == pytest.approx(2.0)
    assert np.all(np.isnan(found[[0, 2, 3, 4, 5, 6]]))


def test_a_smaller_depth_image_is_read_at_the_same_place():
    depth = np.full((10, 15), 1.0, np.float32)
    depth[:, 8:] = 3.0
    assert sample_depth(depth, np.array([[10.0, 5.0], [25.0, 15.0]]), 30, 20) == pytest.approx([1.0, 3.0])
    assert sample_depth(depth, np.zeros((0, 2)), 30, 20).shape == (0,)
