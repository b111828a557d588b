"""What a command line cannot do. Each message names the thing and a remedy."""


class Usage(Exception):
    """A mistake in the command line: exit code 2."""


class Failure(Exception):
    """What went wrong otherwise: exit code 1."""
