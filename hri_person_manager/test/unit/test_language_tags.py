"""Language tags of BCP 47: any way of writing them gives one form; what is none is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hri_person_manager.core.register import LONGEST_TAG, normal_language_tag


def some(pattern):
    return st.from_regex(pattern, fullmatch=True)


# Each part in the case that RFC 5646 recommends, in the order of the form.
TAGS = st.tuples(some("[a-z]{2,3}"), some("([A-Z][a-z]{3})?"), some("([A-Z]{2}|[0-9]{3})?"),
                 st.lists(some("[a-z]{5,8}|[0-9][a-z0-9]{3}"), max_size=2, unique=True).map("-".join),
                 some("(t-[a-z]{2}(-[0-9a-z]{2,8})?)?"), some("(u-co-[a-z0-9]{3,8})?"), some("(x-[a-z0-9]{1,8})?")
                 ).map(lambda parts: "-".join(part for part in parts if part))


@given(TAGS, st.randoms(use_true_random=False))
def test_any_case_and_underscores_give_the_form_of_bcp_47(tag, chance):
    written = "".join(chance.choice((letter.lower(), letter.upper())) for letter in tag)
    assert normal_language_tag("".join(chance.choice("-_") if letter == "-" else letter for letter in written)) == tag


@given(st.text("aZ19-_ux \n\u212a\u217b", max_size=LONGEST_TAG + 6))
def test_whatever_is_written_has_one_form_or_is_refused(text):
    try:
        tag = normal_language_tag(text)
    except ValueError as error:
        assert "is no IETF language tag" in str(error)
    else:
        assert normal_language_tag(tag) == tag and text.isascii() and len(tag) <= len(text) <= LONGEST_TAG


@pytest.mark.parametrize("written, form", [
    ("zh-cmn-Hans", "cmn-Hans"), ("zh-yue-HK", "yue-HK"), ("sgn-ase", "ase"),
    ("X_Whatever_1", "x-whatever-1"), ("en-x-US", "en-x-us"),
    ("en-u-ca-buddhist-t-de-x-a", "en-t-de-u-ca-buddhist-x-a")])
def test_extended_languages_private_tags_and_the_order_of_extensions(written, form):
    assert normal_language_tag(written) == normal_language_tag(form) == form


@pytest.mark.parametrize("garbage", [
    "f", "French", "-", "_", "fr-", "-fr", "fr--FR", "fr FR", "fr\n", "\u217br", "en-GB-GB", "en-abcdefghi", "x", "x-",
    "en-u", "en-u-x-a", "en-x", "de-1901-1901", "en-u-ca-buddhist-u-nu-latn", "12", "\u212ao", "en-x-" + "a-" * 40,
    "zh-cmn-yue-wuu-gan", "x" + "-abcdefgh" * 8])
def test_what_is_no_language_tag_is_refused(garbage):
    with pytest.raises(ValueError, match="is no IETF language tag"):
        normal_language_tag(garbage)
