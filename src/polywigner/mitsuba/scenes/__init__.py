"""Scenes: checking and loading of scene files, surfaces, and rendering of images."""
