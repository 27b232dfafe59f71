"""Errors that a user can mend. The kernels' own are `kernels.InputError` and `kernels.SolveError`."""


class UserError(ValueError):
    """Bad input: the message is one line that names the file or option, and the field."""
