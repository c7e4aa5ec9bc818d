"""Who is measured: frames and MuJoCo's flex, brought to rest by the same steps."""
