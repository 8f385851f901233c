"""Does the loop find what nobody declared? Blind cases over effects and seeds, and the table of how it fared."""
