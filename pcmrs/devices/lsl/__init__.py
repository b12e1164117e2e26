"""Lab Streaming Layer: markers out, markers and signals in, and epochs cut from them."""
