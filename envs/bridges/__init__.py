"""Environments of this project with the interfaces of other libraries; `envs.as_brax` and its like make them."""
