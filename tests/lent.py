"""What is no array of NumPy, but lends one."""


class Lent:
    """As tensors do."""

    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array
