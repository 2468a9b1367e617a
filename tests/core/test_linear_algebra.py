from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from mobo_tuner.core.linear_algebra import (
    cholesky,
    inverse_lower,
    inverse_triangle,
    single_blas_thread,
)


def _blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def _positive_definite(n):
    factor = np.random.default_rng(n).normal(size=(n, n))
    return factor @ factor.T + n * np.eye(n)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_cholesky_and_inverses(n):
    matrix = _positive_definite(n)
    kept = matrix.copy()
    lower, jitter = cholesky(matrix)
    assert jitter == 0.0
    np.testing.assert_array_equal(matrix, kept)
    np.testing.assert_allclose(lower, np.linalg.cholesky(matrix))
    np.testing.assert_allclose(inverse_triangle(lower) @ lower, np.eye(n), atol=1e-12)
    np.testing.assert_allclose(inverse_lower(lower), np.tril(np.linalg.inv(matrix)), atol=1e-12)


@pytest.mark.parametrize("scale", [1e-18, 1.0, 1e18])
def test_cholesky_of_a_singular_matrix_has_jitter(scale):
    matrix = scale * np.ones((20, 20))
    lower, jitter = cholesky(matrix)
    assert 0.0 < jitter < 1e-6 * scale
    np.testing.assert_allclose(lower @ lower.T, matrix + jitter * np.eye(20), rtol=1e-10)


def test_cholesky_of_zeros():
    lower, jitter = cholesky(np.zeros((3, 3)))
    np.testing.assert_allclose(lower @ lower.T, jitter * np.eye(3))


def test_cholesky_refuses_what_is_not_finite():
    with pytest.raises(ValueError, match="not finite"):
        cholesky(np.full((2, 2), np.nan))


def test_cholesky_refuses_what_is_far_from_semi_definite():
    with pytest.raises(ValueError, match="positive semi-definite"):
        cholesky(np.array([[1.0, 1e6], [1e6, 1.0]]))


def test_inverses_refuse_a_singular_triangle():
    with pytest.raises(ValueError, match="singular"):
        inverse_triangle(np.zeros((2, 2), order="F"))
    with pytest.raises(ValueError, match="singular"):
        inverse_lower(np.zeros((2, 2), order="F"))


def test_single_blas_thread_nests_and_restores():
    with threadpool_limits(2, user_api="blas"):
        before = _blas_threads()
        with single_blas_thread():
            with single_blas_thread():
                assert _blas_threads() == {1}
            assert _blas_threads() == {1}
        assert _blas_threads() == before


def test_single_blas_thread_holds_for_the_threads_started_inside():
    def enter():
        with single_blas_thread():
            return _blas_threads()

    with threadpool_limits(2, user_api="blas"):
        before = _blas_threads()
        with single_blas_thread(), ThreadPoolExecutor(2) as pool:
            assert pool.submit(enter).result(10.0) == {1}
            assert pool.submit(_blas_threads).result(10.0) == {1}
            assert _blas_threads() == {1}
        assert _blas_threads() == before


def test_single_blas_thread_restores_after_an_error():
    before = _blas_threads()
    with pytest.raises(RuntimeError), single_blas_thread():
        raise RuntimeError
    assert _blas_threads() == before
