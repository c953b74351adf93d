"""Checking and loading of scene files, surfaces and mirrors of scenes, and rendering of images."""
