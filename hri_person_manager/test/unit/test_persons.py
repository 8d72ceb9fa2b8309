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


def test_a_recogniser_that_begins_anew_takes_along_whom_it_alone_has_named_since_they_became_known():
    known = KnownIds()
    for name, senders in (("ann", ["eyes"]), ("bob", ["eyes", "ears"]), ("cho", ["ears"]), ("dan", ["eyes"])):
        known.add(name)
        for sender in senders:
            known.note_name(name, sender)
    known.note_name("eve", "eyes")      # nobody knows her
    known.remove("dan")
    known.add("dan")                    # forgotten, and known again by something else
    known.renew("eyes", ())
    assert known.outdated == {"ann"}
    known.renew("ears", ("cho",))
    assert known.outdated == {"ann", "bob"}
    known.remove("ann")
    known.add("bob")
    assert known.outdated == set(), "who is forgotten, or named again"
