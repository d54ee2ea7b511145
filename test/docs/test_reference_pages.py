"""The generated pages of the documentation are what the code says now."""

from pages import page
from reference_pages import configuration_page, write

from wbc_controller.middleware.topics import CONTROLLER_TOPICS, MOCK_TOPICS
from wbc_controller.middleware.topics_table import topics_page
from wbc_controller.settings import Settings


def test_the_pages_in_docs_are_up_to_date(tmp_path):
    write(tmp_path)
    for name in ("map", "topics", "configuration"):
        assert page(name) == (tmp_path / f"{name}.md").read_text(encoding="utf-8"), "run: make docs"


def test_every_topic_every_section_and_the_values_of_an_optional_key_are_there():
    table = topics_page()
    for topic in (*CONTROLLER_TOPICS, *MOCK_TOPICS):
        assert f"| `{topic.name}` |" in table
        assert topic.meaning in table
    for section in Settings.model_fields:
        assert f"## `{section}`" in configuration_page()
    assert "| `gait` | `trot`, `walk` | – |" in configuration_page()
