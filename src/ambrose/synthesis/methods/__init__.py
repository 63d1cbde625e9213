"""The methods of design: a class each, with the options that it has."""
