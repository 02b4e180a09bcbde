"""Containers: files, archives and bags, whole or damaged -> messages as they lie in them."""
