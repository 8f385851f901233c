"""The compact dense network: the network, its answer for whole maps, and the class that the project asks."""
