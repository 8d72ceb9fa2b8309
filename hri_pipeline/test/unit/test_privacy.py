"""The notice of what is computed and kept of people."""

from hri_pipeline.core.privacy import DataUse, joined, notice


def test_one_process_with_two_parts_says_both():
    use = joined([DataUse(("boxes", "landmarks"), "/data/p.sqlite", ("templates",), 30.0, True),
                  DataUse(("boxes", "skeletons"))])
    assert use == DataUse(("boxes", "landmarks", "skeletons"), "/data/p.sqlite", ("templates",), 30.0, True)
    assert joined([]) == DataUse(())


def test_the_text_says_what_where_how_long_and_who_agreed():
    text = notice([("/b", DataUse(())),
                   ("/a", DataUse(("names",), "/data/p.sqlite", ("names", "times"), 30.0, True, ("ada", "bob")))])
    assert text.splitlines() == [
        "/a computes: names",
        "    keeps in /data/p.sqlite, encrypted: names, times; removed 30 days after the last time",
        "    agreed to be recognised: ada, bob", "/b computes: nothing of people", "    keeps nothing beyond the run"]
    plain = notice([("/a", DataUse(("names",), "/p", ("names",)))])
    assert "not encrypted" in plain and "without a limit" in plain
