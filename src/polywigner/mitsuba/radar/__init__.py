"""Received power sorted by range, and scenes as clouds of scatterers."""
