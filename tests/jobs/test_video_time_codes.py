"""Time codes: counted as a clock that leaves numbers out, and carried from input to outputs."""

import json
import re
from fractions import Fraction
from pathlib import Path

import av
import OpenEXR
import pytest
from helpers.command_line import Cli
from helpers.plates import DISPLAY, time_code_of, write_plate
from helpers.videos import NTSC, encode, flat_frames, with_sound
from hypothesis import given
from hypothesis import strategies as st

from depthcli.video.frames import time_code_after, time_code_text


def write_coded(path: Path, timecode: str | None) -> None:
    encode(path, flat_frames(range(8)), NTSC, "mpeg4", "yuv420p", timecode=timecode)


def found_in(path: Path) -> set[str]:
    """The time codes that another program sees."""
    with av.open(str(path)) as video:
        tables = (video.metadata, *(stream.metadata for stream in video.streams))
        return {
            text for table in tables for key, text in table.items() if key.lower() == "timecode"
        }


def next_drop_frame(hours: int, minutes: int, seconds: int, frame: int) -> tuple[int, ...]:
    """One frame later in 30 frames a second: no 0 and 1 in a minute, except every tenth."""
    frame += 1
    seconds, frame = seconds + frame // 30, frame % 30
    minutes, seconds = minutes + seconds // 60, seconds % 60
    hours, minutes = (hours + minutes // 60) % 24, minutes % 60
    if not seconds and frame < 2 and minutes % 10:
        frame = 2
    return hours, minutes, seconds, frame


def shown(numbers: tuple[int, ...] | None, rate: Fraction = NTSC) -> str | None:
    return None if numbers is None else time_code_text(numbers, rate)


def parsed(text: str, rate: Fraction = NTSC) -> tuple[int, ...]:
    *words, frame = map(int, re.split(r"[:;]", text))
    pair, second = divmod(frame, 2) if rate > 30 else (frame, 0)
    return *words, pair, int(";" in text), 0, second, *(0,) * 11


@given(st.sampled_from([(0, 0, 58, 0), (9, 59, 30, 5), (23, 59, 59, 0)]), st.integers(0, 4000))
def test_drop_frame_time_codes_leave_out_two_numbers_a_minute(
    start: tuple[int, int, int, int], frames: int
) -> None:
    later: tuple[int, ...] = start
    for _ in range(frames):
        later = next_drop_frame(*later)
    further = (1, *(0,) * 13)
    assert time_code_after((*start, *further), frames, NTSC) == (*later, *further)


@pytest.mark.parametrize(
    ("start", "frames", "rate", "later"),
    [
        ("01:02:03:04", 0, Fraction(24), "01:02:03:04"),
        ("01:02:03:04", 24 * 60 + 21, Fraction(24000, 1001), "01:03:04:01"),
        ("23:59:59:24", 1, Fraction(25), "00:00:00:00"),
        ("00:00:59;59", 1, Fraction(60000, 1001), "00:01:00;04"),
        ("00:00:59:29", 1, NTSC, "00:01:00:00"),
        ("25:00:00:30", 0, Fraction(24), "01:00:01:06"),
        ("00:00:59;23", 1, Fraction(24), None),
        ("00:00:00:00", 0, Fraction(25, 2), None),
        ("00:00:00:00", 0, Fraction(1, 3), None),
        ("00:00:00:00", 0, Fraction(120), None),
    ],
)
def test_time_codes_of_the_next(start: str, frames: int, rate: Fraction, later: str | None) -> None:
    assert shown(time_code_after(parsed(start, rate), frames, rate), rate) == later


@pytest.mark.parametrize("name", ["a.mov", "a.mp4", "a.mkv"])
@pytest.mark.parametrize("start", ["01:02:03:04", "01:02:59;28"])
def test_outputs_have_the_time_code_of_the_first_frame(name: str, start: str, inside: Cli) -> None:
    write_coded(inside.folder / name, start)
    formats = ("mkv", "mp4", "mov", "webm", "exr")
    words = [word for which in formats for word in ("--format", which)]
    for options, frames in (((), 0), (("--start", "3f"), 3), (("--start", "0.1"), 3)):
        later = shown(time_code_after(parsed(start), frames, NTSC))
        done = inside("video", name, *words, "--out", "x.mkv", "--sidecar", "--json", *options)
        assert json.loads(done.stdout)["time_code"] == later
        assert json.loads((inside.folder / "x.depth.json").read_text())["time_code"] == later
        for output in ("x.depth.mkv", "x.preview.mp4", "x.preview.mov", "x.preview.webm"):
            assert found_in(inside.folder / output) == {later}
    last = OpenEXR.File(str(inside.folder / "x.depth.000007.exr")).header()["timeCode"]
    after = time_code_after(parsed(start), 7, NTSC) or ()
    assert (last.hours, last.minutes, last.seconds, last.frame, last.dropFrame) == after[:5]


@pytest.mark.parametrize("rate", [Fraction(48), Fraction(50), Fraction(60000, 1001)])
def test_above_30_frames_a_second_exr_numbers_pairs(rate: Fraction, inside: Cli) -> None:
    last = round(rate) - 1
    start = f"10:00:00:{last - 2:02d}"
    path = inside.folder / "a.mov"
    encode(path, flat_frames(range(8)), rate, "mpeg4", "yuv420p", timecode=start)
    done = inside("video", "a.mov", "--out", "x.%d.exr", "--json")
    assert (done.returncode, json.loads(done.stdout)["time_code"]) == (0, start)
    codes = [OpenEXR.File(str(inside.folder / f"x.{n}.exr")).header()["timeCode"] for n in range(6)]
    wanted = [(0, last - 2), (0, last - 1), (0, last), (1, 0), (1, 1), (1, 2)]
    assert [(code.seconds, 2 * code.frame + code.fieldPhase) for code in codes] == wanted
    assert inside("video", "a.mov", "--out", "y.mkv", "--start", "2f").returncode == 0
    assert found_in(inside.folder / "y.mkv") == {f"10:00:00:{last}"}
    assert inside("convert", "y.mkv", "z.%d.exr").returncode == 0
    code = OpenEXR.File(str(inside.folder / "z.3.exr")).header()["timeCode"]
    assert (code.seconds, code.frame, code.fieldPhase) == (1, 0, 0)


def test_a_time_code_counts_the_frames_of_its_file(inside: Cli) -> None:
    write_coded(inside.folder / "a.mov", "01:02:03:04")
    words = ("--out", "x.mov", "--start", "2f", "--every", "2", "--json")
    assert json.loads(inside("video", "a.mov", *words).stdout)["time_code"] == "01:02:03:06"
    assert found_in(inside.folder / "x.mov") == set()


def test_a_video_of_plates_has_their_time_code(inside: Cli) -> None:
    for number in (1, 2, 3):
        write_plate(inside.folder / "in", number, DISPLAY)
    words = ("--fps", "29.97", "--start", "2f", "--out", "x.mkv", "--json")
    done = inside("video", "in", *words)
    said = json.loads(done.stdout)["time_code"]
    assert parsed(said)[:4] == time_code_of(2)[:4]
    assert found_in(inside.folder / "x.mkv") == {said}


def test_a_time_code_and_audio_are_kept_in_a_pipe(inside: Cli) -> None:
    with_sound(inside.folder / "a.mov", seconds=1, timecode="10:00:00:00")
    done = inside("video", "a.mov", "--out", "-", "--format", "mp4")
    (inside.folder / "x.mp4").write_bytes(done.stdout)
    assert found_in(inside.folder / "x.mp4") == {"10:00:00:00"}
    with av.open(str(inside.folder / "x.mp4")) as video:
        assert (len(video.streams.video), len(video.streams.audio)) == (1, 1)


@pytest.mark.parametrize("stated", [None, "soon"])
def test_without_a_time_code_there_is_none(stated: str | None, inside: Cli) -> None:
    write_coded(inside.folder / "a.mkv", stated)
    done = inside("video", "a.mkv", "--out", "x.mov", "--json")
    assert json.loads(done.stdout)["time_code"] is None
    assert found_in(inside.folder / "x.mov") == set()
