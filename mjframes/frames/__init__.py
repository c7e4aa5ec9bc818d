"""Where frames are placed: distances within the body, clusters, pieces that are held (the paper, §4.4)."""
