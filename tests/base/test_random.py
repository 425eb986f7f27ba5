"""The random stream is numpy's Philox, and its numbers follow the laws they should."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from wakefold.base.random import normals, raw, uniforms

words = st.integers(0, 2**64 - 1)


def stream(key, step, purpose, count):
    return np.random.Philox(key=np.array(key, np.uint64), counter=[0, 0, step, purpose]).random_raw(count)


@given(st.tuples(words, words), st.integers(0, 2**40), st.integers(0, 1000), st.integers(0, 37))
def test_words_are_those_of_numpy(key, step, purpose, count):
    out = np.empty(count, np.uint64)
    raw(np.array(key, np.uint64), step, purpose, out)
    np.testing.assert_array_equal(out, stream(key, step, purpose, count))


@given(st.tuples(words, words), st.integers(0, 2**40), st.integers(0, 37))
def test_uniforms_are_the_upper_53_bits(key, step, count):
    out = np.empty(count)
    uniforms(np.array(key, np.uint64), step, 2, out)
    np.testing.assert_array_equal(out, (stream(key, step, 2, count) >> np.uint64(11)) * 2.0**-53)
    assert ((out >= 0.0) & (out < 1.0)).all()


@given(st.tuples(words, words), st.integers(1, 41))
def test_normals_are_box_and_muller_of_the_uniforms(key, count):
    """The k-th number does not depend on how many are asked for."""
    u, out = np.empty(44), np.empty(count)
    uniforms(np.array(key, np.uint64), 5, 1, u)
    normals(np.array(key, np.uint64), 5, 1, out)
    radius, angle = np.sqrt(-2.0 * np.log1p(-u[::2])), 2.0 * np.pi * u[1::2]
    expected = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]).ravel()[:count]
    np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("fill", "law"), [(uniforms, "uniform"), (normals, "norm")])
def test_the_law_of_many_numbers(fill, law):
    """False alarms, were the key another: 1e-4 by the first line, 1e-5 each by the others (4.5 sd).

    A distribution function that is off by .008 anywhere, or a variance by 3 %, is found with probability .99.
    """
    out = np.empty(200_000)
    fill(np.array([2016, 11], np.uint64), 3, 2, out)
    assert kstest(out, law).pvalue > 1e-4
    assert abs(np.corrcoef(out[:-1], out[1:])[0, 1]) < 0.01
    if law == "norm":
        assert out.mean() == pytest.approx(0.0, abs=0.01)
        assert out.var() == pytest.approx(1.0, abs=0.02)
        assert np.abs(out).max() > 4.0
