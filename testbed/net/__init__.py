"""The network between host, vehicles and onlookers."""
