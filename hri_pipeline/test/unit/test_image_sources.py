
import cv2
import numpy as np
import pytest

from hri_pipeline.core.sources.image_sources import (
    BAR_GREY,
    PictureMotion,
    PictureSource,
    SourceError,
    fit_image,
    is_live,
    open_source,
    pictures_in,
)
from hri_pipeline.core.sources.parameters import SOURCE_PARAMETERS, ImageSourceSettings

RED, GREEN, BLUE, BLACK = (0, 0, 255), (0, 255, 0), (255, 0, 0), (0, 0, 0)


def settings(source, **others) -> ImageSourceSettings:
    small = {"width": 64, "height": 48, "source": str(source), "dark_between_pictures": 0.0}
    small.update(others)
    return SOURCE_PARAMETERS.resolve(small)


def write_picture(path, colour=RED, width=64, height=48):
    assert cv2.imwrite(str(path), np.full((height, width, 3), colour, np.uint8))
    return path


def write_video(path, frames=5, width=64, height=48, rate=10.0):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, (width, height))
    assert writer.isOpened()
    for number in range(frames):
        writer.write(np.full((height, width, 3), 40 * number, np.uint8))
    writer.release()
    return path


def open_and_note(options):
    notes = []
    return open_source(options, notes.append), notes


def brightness(source) -> float:
    return float(source.image().mean())


def test_video_gives_each_frame_once_and_ends(tmp_path):
    source, _ = open_and_note(settings(write_video(tmp_path / "a.avi"), loop=False))
    assert source.rate == pytest.approx(10.0)
    seen = []
    while source.advance(0.0):
        seen.append(brightness(source))
    assert seen == pytest.approx([0.0, 40.0, 80.0, 120.0, 160.0], abs=4.0)
    source.close()
    source.close()


def test_video_loops(tmp_path):
    source, _ = open_and_note(settings(write_video(tmp_path / "a.avi", frames=3), loop=True))
    seen = []
    for _ in range(7):
        assert source.advance(0.0)
        seen.append(brightness(source))
    assert seen == pytest.approx([0.0, 40.0, 80.0, 0.0, 40.0, 80.0, 0.0], abs=4.0)


def test_video_is_brought_to_the_size_asked_for(tmp_path):
    path = write_video(tmp_path / "a.avi", width=32, height=32)
    for fit, shape in (("letterbox", (48, 64, 3)), ("crop", (48, 64, 3)), ("native", (32, 32, 3))):
        source, _ = open_and_note(settings(path, fit=fit))
        assert source.advance(0.0)
        assert source.image().shape == shape


def test_pictures_follow_each_other_in_reading_order(tmp_path):
    for name, colour in (("p10\u00b22.png", BLUE), ("p2.png", GREEN), ("P1.png", RED)):
        write_picture(tmp_path / name, colour)
    (tmp_path / "notes.txt").write_text("not a picture")
    source, notes = open_and_note(settings(tmp_path, seconds_per_picture=2.0, loop=False, fit="crop"))
    shown = []
    for elapsed in (0.0, 1.9, 2.0, 4.5):
        assert source.advance(elapsed)
        shown.append(tuple(source.image()[24, 32]))
    assert shown == [RED, RED, GREEN, BLUE]
    assert not source.advance(6.0)
    assert notes == []


def test_pictures_loop(tmp_path):
    for name, colour in (("1.png", RED), ("2.png", GREEN)):
        write_picture(tmp_path / name, colour)
    source, _ = open_and_note(settings(tmp_path, seconds_per_picture=1.0, loop=True, fit="crop"))
    for elapsed, colour in ((0.5, RED), (1.5, GREEN), (2.5, RED), (101.5, GREEN)):
        assert source.advance(elapsed)
        assert tuple(source.image()[24, 32]) == colour


def test_it_is_dark_between_pictures(tmp_path):
    for name, colour in (("1.png", RED), ("2.png", GREEN)):
        write_picture(tmp_path / name, colour)
    source, _ = open_and_note(settings(tmp_path, seconds_per_picture=4.0, dark_between_pictures=1.0, fit="crop"))
    for elapsed, colour in ((2.9, RED), (3.1, BLACK), (3.9, BLACK), (4.0, GREEN), (7.5, BLACK), (8.0, RED)):
        assert source.advance(elapsed)
        assert tuple(source.image()[24, 32]) == colour
    alone, _ = open_and_note(settings(tmp_path / "1.png", seconds_per_picture=4.0, dark_between_pictures=1.0,
                                      fit="crop"))
    assert alone.advance(3.9)
    assert tuple(alone.image()[24, 32]) == RED


def test_a_damaged_picture_is_skipped_and_named_once(tmp_path):
    (tmp_path / "1.jpg").write_bytes(b"\xff\xd8 not really")
    write_picture(tmp_path / "2.png", GREEN)
    source, notes = open_and_note(settings(tmp_path, seconds_per_picture=1.0, fit="crop"))
    for elapsed in (0.0, 1.0, 2.0, 3.0):
        assert source.advance(elapsed)
        assert tuple(source.image()[24, 32]) == GREEN
    assert len(notes) == 1 and "1.jpg" in notes[0] and "skipped" in notes[0]


def test_a_still_moves_smoothly(tmp_path):
    ramp = np.repeat(np.arange(0, 256, dtype=np.uint8)[None, :, None], 3, axis=2).repeat(192, axis=0)
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    source, _ = open_and_note(settings(tmp_path / "ramp.png", fit="crop", pan=0.1, pan_period=10.0))
    values = []
    for number in range(300):
        assert source.advance(number / 30.0)
        values.append(float(source.image()[:, 32].mean()))
    assert max(values) - min(values) > 20.0
    assert np.abs(np.diff(values)).max() <= 1.6


@pytest.mark.parametrize("make, words", [
    (lambda path: "", ("~source", "/dev/videoN")),
    (lambda path: path / "missing.mp4", ("missing.mp4", "does not exist")),
    (lambda path: path, ("holds no picture", "put some there")),
    (lambda path: "/dev/video99", ("/dev/video99", "connect it")),
    (lambda path: "99", ("/dev/video99", "connect it")),
    (lambda path: "file:///nowhere/x.avi", ("file:///nowhere/x.avi", "check the address")),
])
def test_what_is_not_there_is_named_with_the_mend(tmp_path, make, words):
    with pytest.raises(SourceError) as error:
        open_and_note(settings(make(tmp_path)))
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


def test_an_unreadable_video_is_named_with_the_mend(tmp_path):
    path = tmp_path / "broken.mp4"
    path.write_bytes(b"this is no video" * 100)
    with pytest.raises(SourceError, match="broken.mp4.*convert"):
        open_and_note(settings(path))


def test_damaged_pictures_only(tmp_path):
    (tmp_path / "1.jpg").write_bytes(b"nothing")
    with pytest.raises(SourceError, match="none of the pictures"):
        open_and_note(settings(tmp_path))


def test_a_stream_that_ends_is_an_error_that_can_be_retried(tmp_path):
    address = "file://" + str(write_video(tmp_path / "a.avi", frames=2))
    source, _ = open_and_note(settings(address))
    assert source.live and is_live(address)
    assert source.advance(0.0) and source.image().shape == (48, 64, 3)
    assert source.advance(0.0)
    with pytest.raises(SourceError, match="no images any more"):
        source.advance(0.0)
    source.close()


@pytest.mark.parametrize("name, live", [("0", True), ("/dev/video0", True), ("rtsp://camera/1", True),
                                        ("clip.mp4", False), ("/data/pictures", False), ("", False)])
def test_is_live(name, live):
    assert is_live(name) is live


def test_pictures_in_ignores_other_files(tmp_path):
    write_picture(tmp_path / "b.JPG".lower())
    (tmp_path / "a.mp4").write_bytes(b"")
    assert [path.name for path in pictures_in(tmp_path)] == ["b.jpg"]


def test_one_picture_is_shown_for_its_time(tmp_path):
    source = PictureSource([write_picture(tmp_path / "1.png")],
                           settings(tmp_path, seconds_per_picture=3.0, loop=False), print)
    assert source.advance(2.9)
    assert not source.advance(3.0)


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
