"""Power and complex amplitudes that receivers of a scene receive."""
