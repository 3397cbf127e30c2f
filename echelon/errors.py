"""The one error that means: the input is wrong, not the program."""


class InputError(ValueError):
    """Bad input. The message is one line naming file, key, value and what is allowed; the command exits with 2."""
