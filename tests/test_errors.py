"""What is said of an error."""

import errno
import os

import pytest

from planewise.errors import MissingExtraError, PlanewiseError, naming, needs


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (PlanewiseError("is empty"), "depth: a.png is empty"),
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE)), "a.png cannot be read (Too many open"),
        (OSError(errno.EINVAL, os.strerror(errno.EINVAL)), "a.png cannot be read; it is damaged"),
        (OSError("image file is truncated"), "a.png cannot be read; it is damaged"),
        (KeyError("x"), "a.png cannot be read; it is damaged"),
    ],
)
def test_what_cannot_be_read_is_named(error, message):
    with pytest.raises(PlanewiseError) as raised, naming("depth: a.png"):
        raise error
    assert message in str(raised.value)


@pytest.mark.parametrize("error", [MemoryError(), MissingExtraError("pillow", "drawing")])
def test_what_is_no_fault_of_a_file_is_not_blamed_on_it(error):
    with pytest.raises(type(error)) as raised, naming("depth: a.png"):
        raise error
    assert raised.value is error


def test_a_package_that_is_missing_is_named_with_its_extra():
    message = r"drawing needs the package none, .*planewise\[viz\]"
    with pytest.raises(MissingExtraError, match=message), needs("none", "drawing", "viz"):
        import planewise_needs_this  # noqa: F401
