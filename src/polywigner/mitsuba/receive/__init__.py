"""Power and complex amplitudes that receivers get from a scene."""
