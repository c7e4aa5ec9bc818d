"""How exact: the report against finite elements and MuJoCo's flex, and the paper's Table 2."""
