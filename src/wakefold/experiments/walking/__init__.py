"""Who walks with whom: the ETH and UCY pedestrians."""
