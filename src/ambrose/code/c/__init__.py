"""C99: ``code`` writes a block, ``synchronous`` what stands beside it, ``compiled`` compiles and
runs both here.
"""
