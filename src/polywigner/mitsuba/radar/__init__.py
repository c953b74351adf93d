"""Received power as a function of range, clouds of scatterers, and data cubes of radars."""
