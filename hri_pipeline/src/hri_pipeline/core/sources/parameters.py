"""Parameters of the nodes image_source and sound_source."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, parameter

LETTERBOX, CROP, NATIVE = "letterbox", "crop", "native"
FIT_CHOICES = (LETTERBOX, CROP, NATIVE)
STAY = "stay"
EXIT = "exit"


@dataclass(frozen=True)
class ImageSourceSettings(Settings):
    """Publishes a video file, pictures, a camera or a stream as a ROS camera."""

    source: str = parameter(
        "", "Video, picture, directory of pictures, camera (/dev/video0, or its number as a string) or stream "
        "(rtsp://, http://). Required.")
    width: int = parameter(1280, "Width of the images.", unit="px", minimum=16, maximum=8192)
    height: int = parameter(720, "Height of the images.", unit="px", minimum=16, maximum=8192)
    fit: str = parameter(
        "letterbox", "For a source of other proportions. letterbox: dark bars. crop: edges are cut off. native: its "
        "own size; width and height are ignored.", choices=FIT_CHOICES)
    rate: float = parameter(
        0.0, "Images per second. 0: the source's own, 30 for pictures. A video is played frame by frame at this rate, "
        "so that another rate plays it faster or slower.", unit="Hz", minimum=0.0, maximum=240.0)
    loop: bool = parameter(True, "Start again at the end. Stamps go on; a picture or video is never shown as the past.")
    at_end: str = parameter(
        STAY, "When loop is false. stay: the node stays, `finished` is true. exit: it ends with code 0.",
        choices=(STAY, EXIT))
    wait_for_subscriber: bool = parameter(
        False, "Start only when somebody subscribes; the first frames of a video are not lost then.")
    frame_id: str = parameter("camera_color_optical_frame", "Frame of the images: optical, z forward, x right, y down.")
    hfov: float = parameter(
        60.0, "Horizontal field of view, bars included; gives K in camera_info. A wrong value scales all distances.",
        unit="deg", minimum=5.0, maximum=170.0)
    jpeg_quality: int = parameter(80, "Quality of image/compressed.", minimum=1, maximum=100)
    seconds_per_picture: float = parameter(
        8.0, "How long each picture is shown.", unit="s", minimum=0.1, maximum=3600.0)
    dark_between_pictures: float = parameter(
        1.5, "Black time before the next picture; part of its time. Longer than the trackers' death times, so that "
        "nobody becomes somebody else.", unit="s", minimum=0.0, maximum=60.0)
    pan: float = parameter(
        0.03, "Swing of the pan to each side, as a fraction of the image. 0: still.", minimum=0.0, maximum=0.25)
    pan_period: float = parameter(12.0, "Time of one swing there and back.", unit="s", minimum=0.5, maximum=600.0)
    zoom: float = parameter(
        0.0, "Largest enlargement of a slow zoom, minus one. 0: none. A zoom costs about four times the time of a pan.",
        minimum=0.0, maximum=1.0)
    camera_fourcc: str = parameter(
        "MJPG", "Pixel format asked of a camera; most USB cameras reach 30 Hz at high resolution only with MJPG. "
        "Empty: the driver's choice.")
    retry_period: float = parameter(
        2.0, "How often an absent camera or stream is tried again.", unit="s", minimum=0.1, maximum=60.0)


@dataclass(frozen=True)
class SoundSourceSettings(Settings):
    """Plays a sound file, a directory of them or an ALSA device as audio_common_msgs."""

    source: str = parameter(
        "", "Sound file (libsndfile, or .raw with 16-bit samples), directory of them, or microphone (alsa, or "
        "alsa:DEVICE of `arecord -L`). Required.")
    sample_rate: int = parameter(
        0, "Published rate. 0: that of the (first) file, 16000 of a microphone. A file of another rate is resampled.",
        unit="Hz", minimum=0, maximum=192000)
    channels: int = parameter(
        0, "Published channels. 0: those of the (first) file, 1 of a microphone. A file with one channel is put on "
        "all, several are mixed to one; other numbers do not fit together.", minimum=0, maximum=32)
    chunk: float = parameter(
        0.02, "Length of the sound in one message. Shorter is heard sooner, and costs more.", unit="s", minimum=0.005,
        maximum=1.0)
    rate: float = parameter(
        1.0, "How fast files are played: 2 sends twice as many messages per second, each as it is. Who listens in "
        "real time hears it too high and says that the rate is wrong.", minimum=0.1, maximum=100.0)
    loop: bool = parameter(True, "Start again at the end of a file or directory.")
    pause: float = parameter(
        1.0, "Silence after each file, so that the next is a new turn.", unit="s", minimum=0.0, maximum=600.0)
    at_end: str = parameter(
        STAY, "When loop is false. stay: the node stays, `finished` is true. exit: it ends with code 0.",
        choices=(STAY, EXIT))
    wait_for_subscriber: bool = parameter(False, "Start only when somebody subscribes.")
    raw_rate: int = parameter(16000, "Rate of files that end in .raw.", unit="Hz", minimum=4000, maximum=192000)
    raw_channels: int = parameter(1, "Channels of files that end in .raw.", minimum=1, maximum=32)
    retry_period: float = parameter(
        2.0, "How often an absent microphone is tried again.", unit="s", minimum=0.1, maximum=60.0)


SOURCE_PARAMETERS = ParameterTable("image_source", ImageSourceSettings)
SOUND_SOURCE_PARAMETERS = ParameterTable("sound_source", SoundSourceSettings)
