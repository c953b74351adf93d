"""Received power sorted by range, clouds of scatterers, and data cubes of radars."""
