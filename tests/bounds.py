"""What chance may do to a test over many seeds, so that it raises a false alarm once in 10,000 runs at most."""

from scipy.stats import binom

FALSE_ALARM = 1e-4


def fewest(n, chance):
    """How often, at the least, something of this ``chance`` or more happens in ``n`` independent trials."""
    return int(binom.ppf(FALSE_ALARM, n, chance))
