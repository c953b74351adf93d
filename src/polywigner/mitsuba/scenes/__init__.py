"""Scenes: files checked and loaded, their surfaces, and images rendered from them."""
