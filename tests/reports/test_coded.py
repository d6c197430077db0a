"""A text column as numbers says what the texts say."""

from collections import Counter

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from pipeline.store.column import joined, number_values, rows_equal, text_codes
from reports.coded import CodedText, coded, numbered, paired
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


@given(st.lists(st.integers(0, 9) | st.sampled_from([10**6, 2**40]), max_size=30))
def test_numbers_are_renumbered_as_numpy_does(codes):
    codes = np.array(codes, dtype=np.int64)
    for found, expected in zip(numbered(codes), np.unique(codes, return_inverse=True), strict=True):
        np.testing.assert_array_equal(found, expected)


@given(st.lists(st.sampled_from(["x", "", None, "yy", "z"]), max_size=30))
def test_words_are_counted_in_the_order_of_their_first_occurrence(words):
    counted = CodedText(("z", "yy", "x", ""), np.array([["z", "yy", "x", ""].index(w or "") for w in words], dtype=int))
    assert list(counted.counts().items()) == list(Counter(w or "" for w in words).items())


@given(st.lists(st.lists(st.sampled_from(["x", "", None, "yy"]), max_size=12), max_size=4), st.booleans())
def test_a_column_of_texts_is_the_same_from_its_parts(parts, own_words):
    if own_words:
        parts = [*parts, [f"device-{k}" for k in range(8)], ["x"] * 9]
    words = [word for part in parts for word in part]
    found = joined((pa.array(part, pa.string()) for part in parts), pa.string(), len(words))
    assert found.cast(pa.string()).to_pylist() == words
    assert list(CodedText(*text_codes(found))) == [word or "" for word in words]


def test_few_words_are_kept_once_and_names_of_devices_as_they_are():
    repeated, names = ["pass"] * 90 + ["fail"] * 10, [f"device-{k}" for k in range(100)]
    for words, once in ((repeated, True), (names, False), ([None] * 100, True)):
        found = joined((pa.array(words, pa.string()) for _ in range(3)), pa.string(), 300)
        assert pa.types.is_dictionary(found.type) == once
        assert found.cast(pa.string()).to_pylist() == 3 * words


@given(st.lists(st.lists(st.sampled_from([1.5, None, -2.0]), max_size=5), max_size=4))
def test_a_column_of_numbers_is_the_same_from_its_parts(parts):
    values = [value for part in parts for value in part]
    for kind in (pa.float64(), pa.float32(), pa.int16()):
        chunks = [pa.array([None if v is None else int(v) for v in part], kind) for part in parts]
        found = joined(iter(chunks), kind, len(values))
        assert found.to_pylist() == [None if v is None else int(v) for v in values]
        assert found.type == kind
        assert found.num_chunks == 1
        numbers = number_values(found)
        assert not numbers.flags.writeable
        np.testing.assert_array_equal(numbers, [np.nan if v is None else float(int(v)) for v in values])


def test_more_positions_than_a_map_can_show_are_merged():
    random = np.random.default_rng(1)
    x, y = random.uniform(-50.0, 50.0, (2, 3 * PLACES))
    places, index = _places(x, y, 56.0)
    assert len(places) <= PLACES
    assert np.max(np.abs(places[index] - np.stack([x, y], axis=1))) <= 56.0 / PLACES**0.5 + 1e-9
    exact, _ = _places(np.array([1.0, 1.0, -3.0]), np.array([2.0, 2.0, 0.5]), 5.0)
    np.testing.assert_allclose(exact, [[-3.0, 0.5], [1.0, 2.0]])
