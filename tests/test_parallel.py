"""Work on all cores: linear algebra has one thread beside processes of our own."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from vlab.parallel import limited_to


def blas_threads():
    """Return the number of threads of every library of linear algebra."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


@pytest.mark.parametrize("jobs", [None, 1, 2])
def test_linear_algebra_has_one_thread_within_limited_work(jobs):
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with limited_to(jobs):
            assert blas_threads() == [1] * len(before)
        assert blas_threads() == before
    assert before  # numpy and scipy bring a library
