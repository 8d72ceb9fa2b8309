"""config/<node>.yaml and the table in docs/nodes/<node>.md say what the parameter tables of this package say."""

from pathlib import Path

import pytest

from hri_pipeline.core import parameter_docs

ROOT = Path(__file__).resolve().parents[3]
TABLES = parameter_docs.tables("hri_pipeline")


@pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the pages are only in the sources, not in an install space")
@pytest.mark.parametrize("table", TABLES, ids=[table.node for table in TABLES])
def test_files_agree_with_the_table(table):
    parameter_docs.check(table, *parameter_docs.files(ROOT, "hri_pipeline", table))


@pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the pages are only in the sources, not in an install space")
def test_every_page_with_a_table_has_its_table_in_the_code():
    pages = {page.stem for page in (ROOT / "docs" / "nodes").glob("*.md")
             if parameter_docs.BEGIN in page.read_text(encoding="utf-8").splitlines()}
    assert pages == {table.node for _, table in parameter_docs.registered()}
