import pytest

from certpgo.linalg import compiled


@pytest.fixture(params=[False, True], ids=["numpy", "compiled"])
def compiled_form(request, monkeypatch):
    if request.param and not compiled.AVAILABLE:
        pytest.skip("installed without a C compiler")
    monkeypatch.setattr(compiled, "AVAILABLE", request.param)
