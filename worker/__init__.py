"""Celery: claim -> evaluate -> record."""
