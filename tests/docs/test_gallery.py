"""The gallery: every thumbnail is stored, small, and leads to a page; its commands exist."""

import shlex
import struct

import click
import pytest
from docs_build import DOCS
from docs_build.gallery import page
from docs_build.thumbnails import CARDS, SIZE, number, thumbnail, with_picture

from ambrose.cli import main

NAMES = [*(card.name for card in CARDS), *(number(path) for path in with_picture())]


@pytest.mark.parametrize("name", NAMES)
def test_a_thumbnail_is_stored_in_the_size_of_the_others(name):
    data = (DOCS / thumbnail(name)).read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", data[16:24]) == SIZE
    assert len(data) < 100_000


def test_no_thumbnail_is_left_over():
    assert {path.stem for path in (DOCS / "images" / "gallery").iterdir()} == set(NAMES)


@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.name)
def test_a_card_leads_to_a_page_and_its_commands_exist(card):
    assert (DOCS / card.link).exists()
    for command in card.commands:
        name, *arguments = shlex.split(command)
        _, found, rest = main.resolve_command(click.Context(main), [name, *arguments])
        found.make_parser(click.Context(found, resilient_parsing=True)).parse_args(rest)


def test_the_page_shows_all_of_them(monkeypatch):
    monkeypatch.setenv("DRAFT", "1")
    text = page()
    assert all(f"({thumbnail(name)})" in text for name in NAMES)
