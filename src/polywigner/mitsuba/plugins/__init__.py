"""Mitsuba plugins: the ``wigner`` emitter shape and the ``wigner_receiver`` sensor."""
