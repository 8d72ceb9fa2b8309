"""Slopes and growth of the samples of a soak, and what is called flat."""

import argparse

import pytest

from benchmarks import soak
from benchmarks.soak import FDS, LeastMemory, Samples, figures, floor_growth, growth, read, restarted, settled, slope


def samples(per_hour=0.0, fds=20, pids=(7,), minutes=60.0, parameters=30):
    """A graph with one process that grows by so many MB per hour after it has warmed up."""
    rows, count = [], 121
    for number in range(count):
        at = minutes * number / (count - 1)
        rows.append({"minutes": at, "world": "crowd", "process": "node", "pid": pids[number * len(pids) // count],
                     "count": 1,
                     "rss_mb": 100.0 + min(at, 10.0) + per_hour * at / 60.0, "threads": 9,
                     "fds": fds + (30 if number % 10 == 0 else 0),
                     "cpu_percent": 2.0})
        rows.append({"minutes": at, "world": "crowd", "process": "graph", "parameters": parameters, "faces": 2,
                     "faces_seen": number,
                     "known": 0, "errors": 0})
    return rows


def test_the_slope_of_a_line_with_outliers():
    times = [0.5 * number for number in range(40)]
    values = [3.0 * time + (500.0 if number % 5 == 0 else 0.0) for number, time in enumerate(times)]
    assert slope(times, values)[0] == pytest.approx(3.0, abs=0.5)
    with pytest.raises(ValueError):
        slope([1.0, 1.0], [1.0, 2.0])


def test_memory_that_is_handed_back_every_20_s_has_no_slope():
    """A saw of 40 MB; looks 30 s apart see some of its teeth only."""
    held, memory, told, seen = (lambda at: 200.0 + 2.0 * (at % 20.3)), LeastMemory(), [], []
    for at in range(0, 1200, 2):
        memory.see(7, held(at))
        if at % 30 == 28:
            told.append((at, memory.take(7, held(at))))
            seen.append(held(at))
    assert max(seen) - min(seen) > 35.0
    assert all(200.0 <= least < 204.0 for _, least in told), "of the last half minute, not of all before"
    assert abs(3600.0 * slope(*zip(*told))[0]) < 5.0
    assert memory.take(8, 90.0) == 90.0 and memory.take(7, 500.0) == 500.0


def test_how_certain_a_slope_is():
    times = [0.5 * number for number in range(40)]
    wavering = [40.0 * (number * 7 % 11) for number in range(40)]
    risen, least = slope(times, [3.0 * time + by for time, by in zip(times, wavering)])
    assert least < 2.0 < risen, "a memory that wavers says little in 20 minutes"
    assert slope(times, [3.0 * time for time in times]) == pytest.approx((3.0, 3.0))


def test_growth_is_that_of_the_ends():
    assert growth([1.0] * 10 + [5.0] * 10) == 4.0
    assert growth([7.0]) == 0.0


def test_those_who_are_there_count_as_growth_only_when_they_leave_something():
    busier = [4.0, 30.0, 5.0, 20.0] + [90.0, 60.0, 4.0, 80.0]
    assert floor_growth(busier) == 0.0
    leaking = [value + index for index, value in enumerate(busier)]
    assert floor_growth(leaking) == 6.0
    assert floor_growth([7.0]) == 0.0


def test_the_warm_up_does_not_count():
    assert min(row["minutes"] for row in settled(samples())) == 30.0
    values, reasons = figures(samples())
    assert values == {"rss_mb_per_h": 0.0, "rss_mb_per_h_least": 0.0, "master_mb_per_h": 0.0, "fds_growth": 0,
                      "threads_growth": 0, "parameters_growth": 0, "restarted": []}
    assert reasons == {}


def test_a_leak_is_seen():
    assert figures(samples(per_hour=6.0))[0]["rss_mb_per_h"] == pytest.approx(6.0)
    leaking = samples()
    for row in leaking:
        if row["process"] == "node":
            row["fds"] += int(row["minutes"])
        else:
            row["parameters"] += int(row["minutes"])
    assert figures(leaking)[0]["fds_growth"] > FDS
    assert figures(leaking)[0]["parameters_growth"] >= 20


def test_the_master_is_told_of_apart():
    rows = samples() + [dict(row, process="rosmaster") for row in samples(per_hour=9.0) if row["process"] == "node"]
    values, _ = figures(rows)
    assert values["rss_mb_per_h"] == 0.0 and values["master_mb_per_h"] == pytest.approx(9.0)


def test_a_process_that_was_started_again_is_named():
    assert restarted(samples(pids=(7, 8))) == ["crowd node"]
    assert restarted(samples()) == []


def test_processes_that_come_and_go_have_no_slope():
    rows = [row for number, row in enumerate(samples()) if row["process"] == "graph" or number % 4]
    assert figures(rows)[0] == {}


def test_too_short_a_time_says_so():
    values, reasons = figures(samples(minutes=2.0))
    assert values == {} and "2.0 min" in reasons["flat"]


def test_samples_are_read_as_they_were_written(tmp_path):
    path = tmp_path / "samples.csv"
    with Samples(path) as file:
        file.add(samples(per_hour=6.0))
    with path.open("a", encoding="utf-8") as file:
        file.write("61.0,crowd,node,7")     # killed while it wrote
    assert figures(read(path)) == figures(samples(per_hour=6.0))
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no samples"):
        read(tmp_path / "other.csv")


@pytest.mark.parametrize("rows, left, flat", [
    (samples(), {"topics": []}, True), (samples(per_hour=50.0), {"topics": []}, False),
    (samples(), {"topics": ["/humans/faces/x/roi"]}, False),
    (samples(pids=(7, 8)), {"topics": []}, False)])
def test_what_is_called_flat(rows, left, flat):
    machine = {"load_average": [0.0], "cpu": "", "cores": 2, "system": ""}
    ends = {"crowd": {"left": left, "errors": 0, "first_errors": [], "tracebacks": 0}}
    assert soak._report(rows, ends, "", machine)["flat"] is flat
    assert soak._report(rows, ends, "the stack has ended", machine)["flat"] is False


def test_the_command_line():
    parser = argparse.ArgumentParser()
    soak.register(parser.add_subparsers(dest="command"))
    options = parser.parse_args(["soak", "--minutes", "3"])
    assert options.minutes == 3.0 and not options.json and options.read == ""
