"""Soft bodies in MuJoCo: the plugin, what it reads, attaching, sensors, reading back."""
