"""The person table."""

from hri_person_manager.core.persons import MAX_KNOWN_IDS, KnownIds


def test_known_ids_keep_the_order_of_first_sight_and_drop_the_least_recently_named():
    known = KnownIds()
    assert known.add("ann") and known.add("bob") and not known.add("ann")
    assert known.number("ann", 9) < known.number("bob", 9) < known.number("eve", 9) == 9
    for number in range(MAX_KNOWN_IDS - 1):
        known.add("x%d" % number)
    assert "ann" in known and "bob" not in known and len(list(known)) == MAX_KNOWN_IDS
    known.remove("ann")
    known.remove("ann")
    assert "ann" not in known
