"""Who gets the network in an image, and what a node spends of the time that the machine leaves idle."""

import time
from collections import Counter

import pytest

from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.resources import CoreTime
from hri_pipeline.core.scheduler import IdleShare, InferenceScheduler, Request

FACES = ["f%d" % number for number in range(10)]


def choose(schedule, ids, stamp, urgent=(), **about):
    return schedule.choose([Request(name, first=name in urgent) for name in ids], stamp, **about)


def inferences(budget, faces, rate, seconds, urgent=()):
    counts = Counter()
    most = 0
    for index in range(int(rate * seconds)):
        chosen = choose(budget, faces, 50.0 + index / rate, urgent)
        counts.update(chosen)
        most = max(most, len(chosen)) if index else most
    return counts, most


@pytest.mark.parametrize("images", [10.0, 20.0, 30.0, 60.0])
def test_each_face_gets_its_rate_whatever_the_rate_of_the_images(images):
    counts, _ = inferences(InferenceScheduler(12.0, 1.0), FACES[:3], images, 10.0)
    for face in FACES[:3]:
        assert counts[face] == pytest.approx(min(12.0, images) * 10.0, rel=0.05)


def test_a_rate_of_zero_is_every_image():
    counts, _ = inferences(InferenceScheduler(0.0, 1.0), FACES, 30.0, 2.0)
    assert set(counts.values()) == {60}


def test_at_the_rate_of_the_images_no_turn_is_lost_to_rounding():
    counts, _ = inferences(InferenceScheduler(15.0, 1.0), FACES[:1], 15.0, 20.0)
    assert counts["f0"] >= 299


def test_a_tight_budget_is_shared_fairly_and_never_exceeded():
    budget = InferenceScheduler(12.0, 0.020, cost=0.005)
    counts, most = inferences(budget, FACES, 20.0, 20.0)
    assert most == 4
    assert sum(counts.values()) == pytest.approx(4 * 400, rel=0.02)
    assert max(counts.values()) - min(counts.values()) <= 2
    assert set(counts) == set(FACES)


def test_looks_are_bunched_into_batches_even_of_faces_born_at_different_times():
    budget = InferenceScheduler(10.0, 1.0)
    batches = []
    for index in range(200):
        batches.append(len(choose(budget, FACES[:1 + min(2, index // 7)], 0.05 * index)))
    assert sum(batches[100:]) == pytest.approx(3 * 50, abs=3), "three faces ten times a second for 5 s"
    assert batches[100:].count(0) >= 40, "in every second image"


def test_at_least_one_face_is_looked_at_however_dear_it_is():
    budget = InferenceScheduler(12.0, 0.001)
    budget.spent(10.0, 1)
    counts, _ = inferences(budget, FACES[:4], 20.0, 20.0)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_the_cost_of_a_look_is_learnt():
    budget = InferenceScheduler(12.0, 0.020, cost=0.005)
    for _ in range(60):
        budget.spent(0.008, 4)
    assert budget.cost == pytest.approx(0.002, rel=0.02)
    assert len(choose(budget, FACES, 1.0)) == 9
    budget.spent(float("nan"), 3)
    budget.spent(1.0, 0)
    assert budget.cost == pytest.approx(0.002, rel=0.02)


def test_urgent_faces_come_first_and_new_ones_at_once():
    counts, _ = inferences(InferenceScheduler(12.0, 0.010, cost=0.005), FACES[:6], 20.0, 10.0, urgent=["f5"])
    assert counts["f5"] > 1.5 * counts["f0"] > 0
    budget = InferenceScheduler(12.0, 0.005, cost=0.005)
    inferences(budget, FACES[:3], 20.0, 2.0)
    assert choose(budget, FACES[:3] + ["new"], 52.0) == ["new"]


def test_faces_that_have_gone_are_forgotten():
    budget = InferenceScheduler(12.0, 1.0)
    for index in range(5000):
        choose(budget, ["face%d" % index], 0.05 * index)
    assert len(budget._deadlines) == 1 and len(budget._served) == 1


@pytest.mark.parametrize("arguments", [
    dict(rate=-1.0), dict(rate=10.0, budget=0.0), dict(rate=float("nan")), dict(rate=10.0, cost=0.0), dict(most=-1),
    dict(max_age=0.0)])
def test_nonsense_is_refused(arguments):
    with pytest.raises(ValueError, match="rate"):
        InferenceScheduler(**arguments)
    for share in (-0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match="share"):
            IdleShare(share)


def test_what_is_left_of_the_budget_goes_to_the_next_image():
    """2.4 looks per image are two and three in turn: no face pays for the rounding."""
    budget = InferenceScheduler(0.0, 0.012, cost=0.005)
    per_image = [len(choose(budget, FACES, 50.0 + index / 12.0)) for index in range(100)]
    assert set(per_image) == {2, 3} and sum(per_image) == pytest.approx(240, abs=2)
    counts, _ = inferences(InferenceScheduler(0.0, 0.012, cost=0.005), FACES, 12.0, 20.0)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_what_was_not_needed_is_not_saved_up():
    budget = InferenceScheduler(0.0, 0.02, cost=0.005)
    for index in range(50):
        choose(budget, FACES[:2], 50.0 + index / 12.0)
    assert len(choose(budget, FACES, 50.0 + 50 / 12.0)) == 4


def test_images_that_come_slowly_have_time_for_everybody():
    budget = InferenceScheduler(10.0, 0.01, cost=0.005)
    for index in range(20):
        chosen = choose(budget, FACES, 50.0 + 1.0 * index)
        assert index == 0 or len(chosen) == len(FACES)


def even(rate=0.0, most=0):
    return InferenceScheduler(rate, most=most, batches=False)


@pytest.mark.parametrize("count, rate, fps", [(1, 10.0, 20.0), (3, 10.0, 20.0), (2, 10.0, 15.0), (10, 8.0, 30.0)])
def test_without_batches_everybody_gets_the_rate_and_the_images_an_even_load(count, rate, fps):
    schedule, looks, load = even(rate), Counter(), []
    for index in range(1, int(10 * fps) + 1):
        chosen = choose(schedule, FACES[:count], index / fps)
        load.append(len(chosen))
        looks.update(chosen)
    assert list(looks.values()) == pytest.approx([rate * 10] * count, rel=0.05)
    assert max(load[1:]) - min(load[1:]) <= 1


def test_a_rate_above_that_of_the_images_is_every_image():
    schedule = even(10.0)
    assert all(len(choose(schedule, FACES[:4], index * 0.2)) == 4 for index in range(20))


def test_a_number_per_image_is_shared_fairly_and_never_exceeded():
    schedule, last, longest = even(most=3), dict.fromkeys(FACES, 0.05), 0.0
    for index in range(1, 100):
        chosen = choose(schedule, FACES, index * 0.05)
        assert len(chosen) == 3
        for name in chosen:
            longest, last[name] = max(longest, index * 0.05 - last[name]), index * 0.05
    assert longest <= 0.05 * 4 + 1e-9
    assert schedule.wait(10) == pytest.approx(0.2)


def test_who_was_of_little_urgency_is_due_at_once_when_renewed():
    requests = [Request(name, 0.1 if name == "f7" else 1.0) for name in FACES]

    def images_until_next_turn(renewed):
        schedule = even(most=3)
        turns = ["f7" in schedule.choose(requests, 0.1 * index) for index in range(100)]
        first = turns.index(True, 20)
        schedule = even(most=3)
        for index in range(first + 1):
            schedule.choose(requests, 0.1 * index)
        if renewed:
            schedule.renew("f7")
        return next(index for index in range(1, 100)
                    if "f7" in schedule.choose([Request(name) for name in FACES], 0.1 * (first + index)))

    assert images_until_next_turn(renewed=True) == 1
    assert images_until_next_turn(renewed=False) > 5
    even(most=3).renew("nobody")


def test_what_is_reserved_is_left_but_for_one():
    schedule = even(most=3)
    assert [len(choose(schedule, FACES, 1.0 + reserved, reserved=reserved)) for reserved in range(5)] == [3, 2, 1, 1, 1]


def test_a_pause_of_the_camera_is_no_wait():
    schedule = even(10.0)
    for stamp in (0.0, 0.1, 0.2, 9.0):
        choose(schedule, FACES[:2], stamp)
    assert schedule.wait(2) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("batches", [False, True])
def test_under_a_tight_budget_the_urgent_come_more_often_and_nobody_starves(batches):
    schedule, looks = InferenceScheduler(30.0, 0.010, cost=0.005, batches=batches), Counter()
    requests = [Request(name, 3.0 if name == "f7" else 1.0) for name in FACES]
    for index in range(600):
        looks.update(schedule.choose(requests, index / 30.0))
    others = [looks[name] for name in FACES if name != "f7"]
    assert looks["f7"] == pytest.approx(3 * others[0], rel=0.1) and max(others) - min(others) <= 2


class Machine:
    """Cores whose time goes to nodes and to others, image by image. quota: cores that the nodes may use together."""

    def __init__(self, cores=2, quota=None):
        self.cores, self.now, self.idle, self.others = cores, 0.0, 0.0, 0.0
        self.quota, self.used = quota, 0.0

    def times(self):
        of_quota = [] if self.quota is None else [CoreTime(self.quota, self.quota * self.now - self.used)]
        return [CoreTime(self.cores, self.idle), *of_quota]

    def share(self, share=0.75):
        return IdleShare(share, self.times, lambda: self.now)

    def run(self, seconds, *nodes):
        """Let the nodes work; return their inferences, and the use of all cores in the last half of the time."""
        counts, used, steps = [0] * len(nodes), 0.0, int(seconds * 30)
        for step in range(steps):
            busy = 0.0
            for number, (schedule, count, every, rest) in enumerate(nodes):
                if step % every == 0:
                    chosen = choose(schedule, FACES[:count], self.now)
                    counts[number] += len(chosen)
                    busy += rest + len(chosen) * schedule.cost
                    schedule.note_timing(0.005, rest)
            self.used += busy
            busy = min(busy + self.others / 30.0, self.cores / 30.0)
            self.idle += self.cores / 30.0 - busy
            used += busy * 30.0 / (steps / 2) if step >= steps / 2 else 0.0
            self.now += 1.0 / 30.0
        return counts, used


def faces_node(machine, count, share=0.75, max_age=1.0, threads=ONE_THREAD):
    schedule = InferenceScheduler(10.0, 0.010, cost=0.003, idle=machine.share(share), max_age=max_age, threads=threads)
    return schedule, count, 1, 0.008


def bodies_node(machine, count, share=0.75, threads=ONE_THREAD):
    schedule = InferenceScheduler(10.0, most=3, cost=0.012, batches=False, idle=machine.share(share), max_age=1.0,
                                  threads=threads)
    return schedule, count, 2, 0.015


def test_idle_time_is_spent_up_to_every_image():
    machine = Machine(4)
    node = faces_node(machine, 3)
    machine.run(5.0, node)
    (count,), _ = machine.run(5.0, node)
    assert count == pytest.approx(3 * 30 * 5, rel=0.05), "today's rate would give 150"


def test_without_a_share_nothing_more_is_spent():
    machine = Machine(4)
    (count,), _ = machine.run(10.0, faces_node(machine, 3, share=0.0))
    assert count == pytest.approx(3 * 10 * 10, rel=0.05)


def test_a_quarter_of_the_cores_stays_free_and_both_nodes_get_of_it():
    machine = Machine(2)
    machine.others = 0.2
    faces, bodies = faces_node(machine, 6), bodies_node(machine, 3)
    machine.run(10.0, faces, bodies)
    counts, used = machine.run(10.0, faces, bodies)
    assert used == pytest.approx(1.5, abs=0.12)
    assert counts[0] > 1.1 * 6 * 10 * 10 and counts[1] > 1.1 * 3 * 10 * 10


def test_of_a_quota_a_quarter_stays_free_though_the_machine_is_idle():
    machine = Machine(16, quota=2.0)
    faces, bodies = faces_node(machine, 6), bodies_node(machine, 3)
    machine.run(10.0, faces, bodies)
    counts, used = machine.run(10.0, faces, bodies)
    assert used == pytest.approx(1.5, abs=0.12)
    assert counts[0] > 1.1 * 6 * 10 * 10 and counts[1] > 1.1 * 3 * 10 * 10
    machine.others = 15.5
    machine.run(1.0, faces, bodies)
    assert faces[0].spare == bodies[0].spare == 0.0, "no quota, but no core"


def test_a_quota_that_changes_is_followed_without_a_leap():
    machine = Machine(16, quota=8.0)
    node = faces_node(machine, 10)
    machine.run(200.0, node)        # a quota of more would have given so much more in all this time
    machine.quota = 0.25
    machine.run(1.0, node)
    assert node[0].spare == 0.0
    machine.quota = 0.75
    machine.run(0.2, node)
    assert node[0].spare < 0.3
    _, used = machine.run(20.0, node)
    assert used == pytest.approx(0.75 * 0.75, abs=0.1)


def test_it_gives_way_within_a_second_and_keeps_its_least_budget():
    machine = Machine(2)
    faces, bodies = faces_node(machine, 3), bodies_node(machine, 2)
    machine.run(20.0, faces, bodies)
    assert faces[0].spare + bodies[0].spare > 0.2
    machine.others = 1.5
    machine.run(1.0, faces, bodies)
    assert faces[0].spare == bodies[0].spare == 0.0
    counts, _ = machine.run(5.0, faces, bodies)
    assert counts == [pytest.approx(150, rel=0.06), pytest.approx(100, rel=0.06)]
    machine.others = 0.0
    machine.run(10.0, faces, bodies)
    assert faces[0].spare + bodies[0].spare > 0.2, "and takes it again"


@pytest.mark.parametrize("share", [0.85, 0.9, 0.95, 1.0])
@pytest.mark.parametrize("cores", [2, 4, 16])
def test_a_large_share_is_used_and_given_back_within_a_second_too(share, cores):
    machine = Machine(cores)
    nodes = [faces_node(machine, 8, share) for _ in range(3 * cores // 2)]
    machine.run(20.0, *nodes)
    _, used = machine.run(20.0, *nodes)
    assert 0.9 * min(share, 0.95) * cores < used < 0.99 * cores
    machine.others = float(cores)
    machine.run(1.1, *nodes)
    assert [node[0].spare for node in nodes] == [0.0] * len(nodes)


def test_who_uses_more_and_less_by_turns_takes_no_more_than_on_average():
    """One person; the others' use is near what lets bodies be looked at in each image that is taken."""
    machine = Machine(2)
    faces, bodies = faces_node(machine, 1), bodies_node(machine, 1)
    found = []
    for swing in 10 * (1, -1, -1, 1, 1, 1, -1, -1):
        machine.others = 0.7 + 0.2 * swing
        found.append(machine.run(0.25, faces, bodies)[0][1])
    images = 40 * 4
    assert sum(found[40:]) >= 0.98 * images, "140 of 160 where all that is lacking is given up at once"


def test_no_image_is_left_out_for_more_inferences():
    """Ten faces in every image would take 38 of 33 ms, on however many cores."""
    machine = Machine(16)
    node = faces_node(machine, 10)
    machine.run(5.0, node)
    (count,), _ = machine.run(5.0, node)
    assert 0.5 < count * 0.003 / (5.0 * 30) / (0.8 / 30.0 - 0.008) < 1.02


def test_with_threads_ten_people_get_what_one_has():
    machine, threads = Machine(16), Threads(6)
    faces, bodies = faces_node(machine, 10, threads=threads), bodies_node(machine, 10, threads=threads)
    machine.run(10.0, faces, bodies)
    counts, used = machine.run(5.0, faces, bodies)
    assert counts == [pytest.approx(10 * 30 * 5, rel=0.05), pytest.approx(10 * 15 * 5, rel=0.05)]
    assert faces[0].spare > 0.5 and bodies[0].spare > 1.0 and used < 12.0


def test_threads_take_no_more_of_an_image_than_its_time_and_no_more_cores_than_they_are():
    """Ten inferences of 12 ms in each of 30 images a second: two threads have 2 x (27 - 8) ms."""
    machine, threads = Machine(16), Threads(2)
    schedule = InferenceScheduler(10.0, 0.010, cost=0.012, idle=machine.share(), max_age=1.0, threads=threads)
    machine.run(10.0, (schedule, 10, 1, 0.008))
    (count,), _ = machine.run(5.0, (schedule, 10, 1, 0.008))
    assert 0.8 < count * 0.012 / (5.0 * 30) / (2 * (0.8 / 30.0 - 0.008)) < 1.02
    assert schedule.spare <= 2.0


def test_with_threads_it_gives_way_within_a_second_and_keeps_its_least_budget():
    machine, threads = Machine(8), Threads(3)
    faces, bodies = faces_node(machine, 10, threads=threads), bodies_node(machine, 10, threads=threads)
    machine.run(20.0, faces, bodies)
    assert faces[0].spare + bodies[0].spare > 1.5
    machine.others = 7.0
    machine.run(1.0, faces, bodies)
    assert faces[0].spare == bodies[0].spare == 0.0
    counts, _ = machine.run(5.0, faces, bodies)
    assert counts == [pytest.approx(3.33 * 30 * 5, rel=0.06), pytest.approx(3 * 15 * 5, rel=0.06)], "as on two cores"


def test_with_threads_an_image_gets_as_much_older_as_one_of_them_works():
    schedule = InferenceScheduler(0.0, 1.0, cost=0.005, max_age=0.05, threads=Threads(2))
    for _ in range(20):
        schedule.note_timing(0.01, 0.02)
    assert len(choose(schedule, FACES, 1.0)) == 8, "two times 0.05 s less 0.03 s"
    schedule.note_timing(0.2, 0.02)
    assert len(choose(schedule, FACES, 1.04)) == 1


@pytest.mark.parametrize("step, rest, looks", [
    (0.1, 0.02, 3), (0.2, 0.02, 3), (0.3334, 0.02, 5), (0.5, 0.02, 7), (0.5, 0.3, 6), (0.5, 0.45, 3), (0.5, None, 3)])
def test_slow_images_have_more_looks_where_the_time_between_them_is_not_needed(step, rest, looks):
    """Three for each image are few at two images a second. rest: s of an image for all else; None: of a recording."""
    schedule = InferenceScheduler(10.0, most=3, cost=0.015, max_age=0.05, batches=False)
    for index in range(300):
        if rest is not None:
            schedule.note_timing(0.01, rest)
        chosen = choose(schedule, [str(number) for number in range(12)], step * index)
    assert len(chosen) == looks


def test_threads_that_come_later_count_from_the_next_image_on():
    """As of a network whose card has failed: it runs in the threads of the processor from now on."""
    schedule = InferenceScheduler(0.0, 1.0, cost=0.005, max_age=0.05)
    for _ in range(20):
        schedule.note_timing(0.01, 0.02)
    assert len(choose(schedule, FACES, 1.0)) == 4
    schedule.share_among(Threads(2))
    schedule.note_timing(0.01, 0.02)
    assert (schedule.threads, len(choose(schedule, FACES, 1.04))) == (2, 8)


def on_a_card(schedule, count, seconds, rest=0.016, begin=0.0, age=0.005):
    """Let a network run that takes 8 ms and .7 ms for each of 12 faces; how many got it in each image of 30 a
    second."""
    looks = []
    schedule.share_among(ONE_THREAD, together=min(count, 12))
    for step in range(int(seconds * 30)):
        looks.append(len(choose(schedule, map(str, range(count)), begin + step / 30.0)))
        took = 0.008 + 0.0007 * looks[-1] if looks[-1] else 0.0
        schedule.spent(took, looks[-1])
        schedule.note_timing(age, rest)
    return looks


def test_on_a_card_all_come_in_every_second_image():
    """One by one ten faces got 5.5 looks a second: of two in each image one took 5 ms, and there was no time for
    more."""
    schedule = faces_node(Machine(16), 10)[0]
    looks = on_a_card(schedule, 10, 5.0)
    assert set(looks) == {0, 10}
    assert looks[-60:].count(10) == pytest.approx(20, abs=1), "ten times a second without idle time that is known"
    machine = Machine(16)
    schedule = faces_node(machine, 10)[0]
    looks = []
    for second in range(8):
        machine.now, machine.idle = float(second), 15.0 * second
        looks += on_a_card(schedule, 10, 1.0, begin=float(second))
    assert looks[-30:].count(10) == pytest.approx(15, abs=1), "as much as there is time for, but not in each image"


@pytest.mark.parametrize("budget", [3.0, 4.0])
def test_on_a_card_time_for_all_is_saved_up_and_nobody_is_left_out(budget):
    schedule = InferenceScheduler(10.0, 1e-3 * budget, cost=0.0015)
    looks = on_a_card(schedule, 10, 8.0)
    assert set(looks) == {0, 10} and looks.count(10) == pytest.approx(8.0 * 30 * budget / 15, abs=2), "all take 15 ms"


@pytest.mark.parametrize("count, wait", [(1, 0.1), (5, 5 / 30.0), (10, 10 / 30.0), (12, 12 / 30.0), (24, 0.25)])
def test_on_a_card_old_images_get_one_look_each_on_average_or_two_a_second(count, wait):
    """As without a card: of five in old images each had six looks a second there, and two on a card."""
    schedule = InferenceScheduler(10.0, 0.010, cost=0.0015, max_age=0.1)
    on_a_card(schedule, count, 2.0)
    looks = on_a_card(schedule, count, 3.0, begin=2.0, age=0.2)
    assert set(looks) == {0, min(count, 12)} and len(looks) - looks.count(0) == pytest.approx(3.0 / wait, abs=2)


@pytest.mark.parametrize("count, rate", [(14, 10.0), (25, 30 * 10.0 / 16.4 * 12 / 25)])
def test_on_a_card_more_than_come_together_take_turns(count, rate):
    """All in one image would make each too old: they had two looks a second."""
    schedule = InferenceScheduler(10.0, 0.010, cost=0.0015, max_age=0.1)
    on_a_card(schedule, count, 2.0, rest=0.04, age=0.03)
    looks = on_a_card(schedule, count, 4.0, begin=2.0, rest=0.04, age=0.03)
    assert max(looks) == 12 and sum(looks) / count / 4.0 == pytest.approx(rate, rel=0.1)
    assert schedule.wait(100) < 0.2, "nobody is left out"


@pytest.mark.parametrize("later", [True, False], ids=["card", "processor"])
def test_on_a_card_nobody_pays_later_for_having_come_along_early(later):
    """They had no look for 5 to 60 s once who came more often had left."""
    machine = Machine(16)
    schedule = faces_node(machine, 10)[0]
    for step in range(900):
        machine.now, machine.idle = step / 30.0, 4.2 * step / 30.0
        schedule.share_among(ONE_THREAD, together=10)
        chosen = schedule.choose([Request(name, 4.0 if name == "f0" else 1.0) for name in FACES], step / 30.0)
        schedule.spent(0.015, len(chosen))
        schedule.note_timing(0.005, 0.016)
    schedule.share_among(ONE_THREAD, together=3 if later else 0)
    looks = [len(choose(schedule, FACES[1:4], 30.0 + step / 30.0)) for step in range(30)]
    assert any(looks[:4]) and sum(looks) >= 3 * 9


def test_who_comes_anew_in_each_image_of_a_card_puts_nobody_off():
    schedule = InferenceScheduler(10.0, 0.1, cost=0.0015, max_age=1.0)
    schedule.share_among(ONE_THREAD, together=2)
    for step in range(300):
        choose(schedule, ["f0", "new%d" % step], step / 30.0)
    assert [choose(schedule, ["f0"], 10.0 + step / 30.0) for step in range(4)].count(["f0"]) == 1


def test_who_is_late_on_a_card_has_no_precedence_after_it():
    """All come together there, as seldom as the time for all allows, who should come more often, too."""
    schedule = InferenceScheduler(10.0, 0.003, cost=0.003, max_age=1.0, idle=Machine(16).share(0.75))
    for step in range(900):
        schedule.share_among(ONE_THREAD, together=10)
        schedule.choose([Request(name, 4.0 if name == "f0" else 1.0) for name in FACES], step / 30.0)
        schedule.note_timing(0.005, 0.016)
    schedule.share_among(ONE_THREAD)
    looks = Counter(name for step in range(120) for name in choose(schedule, FACES[:4], 30.0 + step / 30.0))
    assert min(looks.values()) == pytest.approx(30, abs=4) and len(looks) == 4


def test_the_cost_is_the_time_of_all_threads():
    threads = Threads(3)
    schedule = InferenceScheduler(cost=0.02, threads=threads)

    def work(part):
        began = time.thread_time()
        while time.thread_time() - began < 0.02 * len(part):
            pass
        return part

    for _ in range(5):
        with schedule.measure() as count:
            count(len(threads.in_parts(work, range(6))))
    assert schedule.cost == pytest.approx(0.02, rel=0.2)
    threads.close()


def test_the_age_is_not_exceeded_but_by_one_inference():
    schedule = InferenceScheduler(0.0, 1.0, cost=0.005, max_age=0.05)
    for _ in range(20):
        schedule.note_timing(0.01, 0.02)
    assert len(choose(schedule, FACES, 1.0)) == 4, "0.05 s less 0.03 s"
    schedule.note_timing(0.2, 0.02)
    assert len(choose(schedule, FACES, 1.04)) == 1


def test_with_idle_time_the_urgent_get_it_first():
    machine = Machine(2)
    machine.others = 1.1
    schedule, looks = faces_node(machine, 10)[0], Counter()
    requests = [Request(name, 3.0 if name == "f7" else 1.0) for name in FACES[:2] + ["f7"]]
    for _ in range(900):
        schedule.note_timing(0.005, 0.008)
        chosen = schedule.choose(requests, machine.now)
        looks.update(chosen)
        machine.idle += (2.0 - 1.1) / 30.0 - 0.008 - len(chosen) * 0.003
        machine.now += 1.0 / 30.0
    assert looks["f7"] > 1.3 * looks["f0"] > 0 and looks["f0"] >= 0.95 * 10 * 30


def test_without_a_measurement_of_the_idle_time_the_least_budget_stays():
    def nothing():
        raise OSError("no /proc/stat")

    schedule, count, *_ = faces_node(Machine(), 3)
    schedule._idle = IdleShare(0.75, nothing, lambda: 0.0)
    schedule.note_timing(0.005, 0.008)
    counts, _ = inferences(schedule, FACES[:count], 30.0, 5.0)
    assert sum(counts.values()) == pytest.approx(150, rel=0.05)


def test_recorded_images_get_the_same_inferences_on_every_machine():
    machine = Machine(16)
    schedule, count, *_ = faces_node(machine, 3)
    looks = 0
    for _ in range(300):
        looks += len(choose(schedule, FACES[:count], machine.now))
        machine.now, machine.idle = machine.now + 1.0 / 30.0, machine.idle + 16.0 / 30.0
    assert looks == pytest.approx(300, rel=0.05)


def test_nobody_is_lost_in_images_that_are_old_and_slow():
    """Ten faces, three images a second, each too old already: nobody waits for much longer than half a second."""
    schedule, last = InferenceScheduler(10.0, 0.2, cost=0.005, max_age=0.05), {}
    for index in range(60):
        schedule.note_timing(0.3, 0.3)
        for name in choose(schedule, FACES, index / 3.0):
            assert index / 3.0 - last.get(name, index / 3.0) < 0.7
            last[name] = index / 3.0
    assert set(last) == set(FACES)


def test_idle_time_is_spent_in_every_image_that_is_taken_though_two_come_close_together_and_some_are_slow():
    """A node takes 15 of 30 images a second: now and then one that comes late, and then the next one; one image a
    second takes 40 ms longer."""
    machine = Machine(2)
    schedule = InferenceScheduler(cost=0.012, batches=False, idle=machine.share())
    schedule.limit(10.0, most=3, max_age=0.5, max_rate=15.0)
    number, inferences_at = 0, []
    for turn in range(600):
        number += (2, 2, 3, 1)[turn % 4]
        schedule.note_timing(0.005, 0.048 if turn % 15 == 0 else 0.008)
        inferences_at += [turn] * len(choose(schedule, FACES[:1], number / 30.0))
        machine.now, machine.idle = machine.now + 1.0 / 15.0, machine.idle + 1.0 / 15.0
    assert sum(turn >= 300 for turn in inferences_at) == pytest.approx(300, rel=0.05)
