"""What is wrong with a result: ``plausibility`` calls the others."""
