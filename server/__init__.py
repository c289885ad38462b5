"""The record (database, blobs, lifecycle, ranking) and its two faces (REST, pages)."""
