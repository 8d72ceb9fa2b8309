import numpy as np
import pytest

from hri_pipeline.core.sources.image_sources import BAR_GREY, PictureMotion, fit_image


def gradient(width=200, height=100):
    """A picture whose blue is x and whose green is y, px."""
    picture = np.zeros((height, width, 3), np.uint8)
    picture[..., 0] = np.arange(width)[None]
    picture[..., 1] = np.arange(height)[:, None]
    picture[..., 2] = 255
    return picture


@pytest.mark.parametrize("options", [{"pan": 0.3}, {"pan": -0.1}, {"zoom": 2.0}, {"period": 0.0}])
def test_illegal_construction(options):
    with pytest.raises(ValueError):
        PictureMotion(gradient(), 100, 50, **options)


def test_view_is_the_window_of_the_picture_between_pixels():
    # A canvas of exactly the picture's size: 160 + 2 * (16 + 1) = 194, 80 + 2 * (8 + 1) = 98.
    motion = PictureMotion(gradient(194, 98), 160, 80, fit="crop", pan=0.1, period=8.0)
    for elapsed in np.linspace(0.0, 30.0, 61):
        left, top, enlargement = motion.window(elapsed)
        view = motion.view(elapsed)
        assert view.shape == (80, 160, 3) and enlargement == 1.0
        assert 1.0 <= left <= 33.0 and 1.0 <= top <= 17.0
        columns, rows = left + np.arange(160), top + np.arange(80)
        assert np.abs(view[40, :, 0] - columns).max() <= 1.0
        assert np.abs(view[:, 80, 1] - rows).max() <= 1.0


def test_pan_never_jumps():
    motion = PictureMotion(gradient(), 160, 80, pan=0.1, zoom=0.3, period=8.0)
    windows = np.array([motion.window(number / 30.0) for number in range(2000)])
    # 2 pi / 8 s * 16 px / 30 Hz = 0.42 px; the zoom adds to it.
    assert np.abs(np.diff(windows[:, 0])).max() < 0.42 + 0.35
    assert np.abs(np.diff(windows[:, 2])).max() < 0.005
    assert windows[:, 2].min() >= 1.0 and windows[:, 2].max() == pytest.approx(1.3, abs=0.01)


def test_zoom_enlarges_about_the_window():
    motion = PictureMotion(gradient(194, 98), 160, 80, fit="crop", pan=0.1, zoom=0.5, period=8.0)
    elapsed = 8.0 * 1.91 / 2.0
    left, top, enlargement = motion.window(elapsed)
    assert enlargement == pytest.approx(1.5)
    view = motion.view(elapsed)
    assert np.abs(view[40, :, 0] - (left + np.arange(160) / 1.5)).max() <= 1.0


@pytest.mark.parametrize("width, height", [(300, 100), (100, 300), (1000, 900), (64, 36), (3, 500)])
def test_letterbox_keeps_the_whole_picture_in_view(width, height):
    picture = np.full((height, width, 3), 255, np.uint8)
    motion = PictureMotion(picture, 160, 90, fit="letterbox", pan=0.05, period=5.0)
    # What stays in view keeps its brightness; half a row at the edge is 1.2.
    lights = [motion.view(elapsed).mean() for elapsed in np.linspace(0.0, 20.0, 50)]
    assert max(lights) - min(lights) < 1.25
    assert motion.view(0.0).shape == (90, 160, 3)


def test_crop_fills_the_image():
    motion = PictureMotion(np.full((300, 100, 3), 255, np.uint8), 160, 90, fit="crop", pan=0.1, zoom=0.2)
    for elapsed in np.linspace(0.0, 20.0, 50):
        assert motion.view(elapsed).min() == 255


def test_native_has_the_size_of_the_picture():
    assert PictureMotion(gradient(200, 100), 7, 7, fit="native").view(1.0).shape == (100, 200, 3)


def test_fit_image():
    picture = np.full((100, 200, 3), 255, np.uint8)
    boxed = fit_image(picture, 100, 100, "letterbox")
    assert boxed.shape == (100, 100, 3)
    assert (boxed[:25] == BAR_GREY).all() and (boxed[25:75] == 255).all() and (boxed[75:] == BAR_GREY).all()
    assert (fit_image(picture, 100, 100, "crop") == 255).all()
    assert fit_image(picture, 7, 7, "native") is picture
    assert fit_image(picture, 200, 100, "crop") is picture
    with pytest.raises(ValueError, match="letterbox, crop, native"):
        fit_image(picture, 7, 7, "stretch")
