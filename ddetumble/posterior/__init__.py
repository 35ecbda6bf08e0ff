"""Posteriors: emcee and NUTS over any fit of the toolkit, checkpoints, results as ArviZ reads them, model weights."""
