"""What is wrong with a record before anything is fitted: ``diagnosis`` calls the others."""
