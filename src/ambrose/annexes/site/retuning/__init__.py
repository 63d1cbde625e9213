"""Retuning on site: from a record of the running machine to the change that is signed."""
