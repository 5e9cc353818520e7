"""Contacts without names under their public path; the room is `nls.missions.contacts`."""

from nls.missions.contacts import Associated, associate

__all__ = ["Associated", "associate"]
