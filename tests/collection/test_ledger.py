"""The ledger: each content is granted to one scene, whatever the order of claims."""

from hypothesis import given
from hypothesis import strategies as st

from gsc_jax.collection.worker import Ledger

CLAIMS = st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from("123")), max_size=30)


@given(CLAIMS, st.dictionaries(st.sampled_from("abc"), st.lists(st.sampled_from("12"), min_size=1)))
def test_each_content_is_granted_to_one_scene(claims, finished):
    ledger, granted, attempts = Ledger(finished), {}, {}
    for key, scene in claims:
        claim = ledger.claim(key, scene)
        if scene in finished.get(key, ()):
            assert claim.owner == scene
        elif claim.owner is None:
            assert granted.setdefault(key, scene) == scene
            assert key not in finished
            attempts[key] = attempts.get(key, 0) + 1
            assert claim.attempt == attempts[key]
        else:
            assert claim.owner == (finished[key][0] if key in finished else granted[key])


def test_workers_of_a_node_have_numbers_of_their_own():
    ledger = Ledger({})
    slots = [ledger.slot(*pair) for pair in (("n", "a"), ("n", "b"), ("m", "c"), ("n", "a"))]
    assert slots == [0, 1, 0, 0]
