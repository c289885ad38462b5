"""The metric core: bytes -> validated arrays -> matches -> scores.

Pure functions on arrays. Knows no web, no database and no queue.
"""
