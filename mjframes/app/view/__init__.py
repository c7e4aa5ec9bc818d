"""A scene in a browser while it runs: `grip`, `simulation`, `cameras` know of no page; `stage`, `controls` fill it."""
