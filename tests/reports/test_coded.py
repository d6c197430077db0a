"""A text column as numbers says what the texts say."""

from collections import Counter

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from pipeline.store.column import number_values, rows_equal, text_codes
from reports.coded import CodedText, coded, paired
from reports.run.figures.wafermap import PLACES, _places

TEXTS = st.lists(st.sampled_from(["pass", "fail", "", "undecided"]), max_size=30)


@given(TEXTS, TEXTS)
def test_codes_count_compare_and_pair_as_the_texts_do(first, second):
    n = min(len(first), len(second))
    first, second = first[:n], second[:n]
    a, b = coded(first), coded(second)
    assert list(a) == first
    assert a.counts() == Counter(first)
    assert list(a.counts()) == list(dict.fromkeys(first))
    assert a.equals("pass").tolist() == [text == "pass" for text in first]
    assert list(a.filled(b)) == [own or other for own, other in zip(first, second)]
    pairs, index = paired(a, b)
    assert [pairs[k] for k in index] == list(zip(first, second))


@given(
    st.lists(st.lists(st.sampled_from(["x", "", None, "yy"]), max_size=5), min_size=1, max_size=4), st.integers(0, 3)
)
def test_columns_of_chunks_are_read_without_their_offsets(chunks, offset):
    texts = pa.chunked_array([pa.array([None, *chunk], pa.string())[1:] for chunk in chunks]).slice(offset)
    words = ["" if text is None else text for text in texts.to_pylist()]
    assert list(CodedText(*text_codes(texts))) == words
    numbers = pa.chunked_array(
        [pa.array([7, *map(len, filter(None, chunk)), None], pa.int32())[1:] for chunk in chunks]
    )
    found, expected = number_values(numbers), [np.nan if v is None else float(v) for v in numbers.to_pylist()]
    np.testing.assert_array_equal(found, expected)
    table = pa.table({"name": texts, "row": list(range(len(words)))})
    assert rows_equal(table, "name", "x")["row"].to_pylist() == [k for k, word in enumerate(words) if word == "x"]


def test_more_positions_than_a_map_can_show_are_merged():
    random = np.random.default_rng(1)
    x, y = random.uniform(-50.0, 50.0, (2, 3 * PLACES))
    places, index = _places(x, y, 56.0)
    assert len(places) <= PLACES
    assert np.max(np.abs(places[index] - np.stack([x, y], axis=1))) <= 56.0 / PLACES**0.5 + 1e-9
    exact, _ = _places(np.array([1.0, 1.0, -3.0]), np.array([2.0, 2.0, 0.5]), 5.0)
    np.testing.assert_allclose(exact, [[-3.0, 0.5], [1.0, 2.0]])
