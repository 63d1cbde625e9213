"""The axis along the shaft: the lag of a thrust magnet's solid core."""
