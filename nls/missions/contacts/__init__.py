"""Contacts without names: which of them are of one landmark."""

from nls.missions.contacts.associate import Associated, associate

__all__ = ["Associated", "associate"]
