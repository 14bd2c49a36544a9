"""One BLAS thread around small factorisations: with two, a 100 × 100 Cholesky takes three times as
long.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController

LARGEST_FOR_ONE_THREAD = 400  # rows


@contextmanager
def one_thread_if_small(size: int) -> Iterator[None]:
    """Pin BLAS to one thread while matrices of `size` rows are factored; larger ones keep all
    threads.
    """
    if size > LARGEST_FOR_ONE_THREAD:
        yield
        return
    with one_thread():
        yield


@contextmanager
def one_thread() -> Iterator[None]:
    """Pin BLAS to one thread: for work that runs in threads of its own on products of a few columns
    (also as a decorator).
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()  # scanning the loaded libraries costs milliseconds, so once
