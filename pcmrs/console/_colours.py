"""Colours that people who cannot tell red from green can tell apart (Okabe and Ito)."""

BLUE, SKY, GREEN, ORANGE, VERMILION, PURPLE = "#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00", "#cc79a7"
GREY = "#9aa5b1"
