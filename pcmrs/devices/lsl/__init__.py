"""Lab Streaming Layer: sending markers, receiving markers and signals, and cutting epochs from them."""
