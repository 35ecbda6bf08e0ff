"""How fast the toolkit is, beside the strongest thing that a user would write by hand."""
