"""Messages that are composed piece by piece, at once."""


def whole(pieces):
    """Take all pieces, and return the message."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            return end.value
