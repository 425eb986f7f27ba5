"""Numbers of the operations of predicates, for those who write programs and the kernels that run them."""

NEAR, SAME_VELOCITY, SLOW, AHEAD, CLOSING, SEEN, BEGIN, NOT = range(8)
