"""Checks of certificates, without the code that made them: only values, linear algebra and exact numbers."""

from deshybrid.verify.design import verify_design
from deshybrid.verify.design_file import read_design
from deshybrid.verify.plan import verify_plan
from deshybrid.verify.plan_file import is_plan
from deshybrid.verify.report import Check, VerifyReport

__all__ = ["Check", "VerifyReport", "is_plan", "read_design", "verify_design", "verify_plan"]
