"""The page itself: figures, widgets, and the session that joins them to states and views."""
