"""Files of other software: read here, and turned into RAS and m."""
