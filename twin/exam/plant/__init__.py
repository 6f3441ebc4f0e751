"""The second plant: an independent implementation of the control law with richer mechanics. Imports nothing else of `twin`."""
