"""The reference pages of the views match the code."""

import functools
import re

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.views.shipped import SHIPPED
from stkzoo.wrappers.racing import MEANINGS, PARTS, SIZE
from tests.docs.test_extensions import extension


@functools.cache
def pages():
    return extension("view_pages").pages()


def rows(page, part=""):
    """Returns the index range of each entry on a page."""
    text = pages()[f"reference/views/{page}.md"].split("## Action")[0]
    text = text.partition(f"### `{part}`")[2] if part else text
    found = re.findall(r"^\| (\d+)(?: to (\d+))? \| `(\w+)` \|", text, re.M)
    return {name: slice(int(a), int(b or a) + 1) for a, b, name in found}


def test_every_view_has_a_page():
    names = {f"reference/views/{view.name}.md" for view in SHIPPED}
    assert set(pages()) == {*names, "reference/views/index.md"}


def test_every_number_of_racing_is_documented():
    places = rows("racing")
    assert set(places) == set(PARTS) == set(MEANINGS)
    assert places["bads_beside"].stop == SIZE


@pytest.mark.slow
def test_the_documented_entries_of_a_vector_match_its_numbers():
    seen = {}
    for view in ("simple", "box_discrete"):
        with race_v0.parallel_env(num_kart=3, track="lighthouse", view=view) as env:
            observations, _ = env.reset(seed=1, options={"start": 300.0})
            seen[view] = observations["kart_0"]
    places = rows("box_discrete")
    for key, value in seen["simple"].items():
        if key == "kart_type":
            continue
        part = seen["box_discrete"][places[key]]
        if np.issubdtype(np.asarray(value).dtype, np.floating):
            np.testing.assert_array_equal(part, np.ravel(value), err_msg=key)
        else:
            ones = part.reshape(np.size(value), -1)
            np.testing.assert_array_equal(ones.argmax(axis=1), np.ravel(value), err_msg=key)
            assert ones.sum() == np.size(value), key
