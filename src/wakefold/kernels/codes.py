"""Numbers of the operations and features of predicates, for those who write programs and the kernels that run them."""

NEAR, SAME_VELOCITY, SLOW, AHEAD, CLOSING, SEEN, AND, OR, NOT = range(9)
# Squared distance and its variance per axis; squared relative speed, variance; squared speed of the first and of the
# second, variances; how far the second is ahead of and beside the first's course; d(distance)/dt; whether both are seen
DIST2, VAR, SPEED2, VAR_V, FIRST2, VAR_1, SECOND2, VAR_2, ALONG, BESIDE, OPENING, BOTH_SEEN = range(12)
FEATURES = 12
