"""The one exception that means: the user's input is at fault, and here is the mend."""


class BadInput(ValueError):
    """Input that cannot be used. Its message is one line: what (file, row, key), why, and the mend.

    The command line prints the message and exits with code 2; library callers may catch it as a
    ValueError.
    """
