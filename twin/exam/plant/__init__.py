"""The second plant: an independent implementation of the control law and richer mechanics. Imports nothing of `twin` outside."""
