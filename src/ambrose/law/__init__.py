"""What controls: ``law`` knows the kinds, ``loop`` closes them and says when they act."""
