"""Errors that a user can mend. The kernels' own are `kernels.InputError` and `kernels.SolveError`."""


class UserError(ValueError):
    """Bad input: the message is one line that names the file or option, and the field."""


class RoomError(UserError):
    """What is asked for takes more memory than is free."""


def first_line(error: BaseException) -> str:
    """An error in one line: of a system's error its file and reason, else the first line of its message, or its kind."""
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error).splitlines()[0] if str(error).strip() else type(error).__name__
