"""The colours of all figures: colour-blind readers tell them apart."""

INK = "#1b2733"
GREY = "#66727f"
PALE = "#c9d1d9"
FAINT = "#eef1f4"
MORE = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of the Okabe-Ito palette, for further models
BEFORE = "#d55e00"
AFTER = "#0072b2"
KIN = "#7fc0ea"
OTHER = "#a3aeb9"
FLOOR = "#8a97a5"
PLACE = "#fbedbd"
SHADES = ("#0072b2", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#e69f00", "#7a5195", "#66727f")  # of equals
