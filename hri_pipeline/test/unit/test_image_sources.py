from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hri_pipeline.core.sources.image_sources import PictureSource, SourceError, is_live, open_source, pictures_in
from hri_pipeline.core.sources.parameters import SOURCE_PARAMETERS

RED, GREEN, BLUE, BLACK = (0, 0, 255), (0, 255, 0), (255, 0, 0), (0, 0, 0)


def settings(source, **others) -> SimpleNamespace:
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
    for name, colour in (("p10.png", BLUE), ("p2.png", GREEN), ("P1.png", RED)):
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
