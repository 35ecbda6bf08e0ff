"""Where a model fails, and which physics it lacks."""
