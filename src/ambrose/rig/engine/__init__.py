"""The compiled virtual rig: ``state`` as arrays, ``kernel`` as what runs, ``inputs`` what a
scenario does.
"""
