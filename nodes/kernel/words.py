"""Numbers with their nouns, as people read them."""


def counted(number: float, noun: str, plural: str = "") -> str:
    """A number with its noun: ``1 tick``, ``2 ticks``, ``0 ticks``.

    Args:
        number: how many; a fraction is rounded, and the noun goes by what is shown.
        noun: for one.
        plural: for any other number; by default the noun with an s.
    """
    shown = f"{number:.0f}"
    return f"{shown} {noun if shown == '1' else plural or f'{noun}s'}"
