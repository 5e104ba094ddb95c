//! StoryVariables and parameters whose values actions set while the scenario runs.

use std::collections::BTreeMap;

use super::entities::Entity;
use super::error::ScenarioImportError;
use super::limits::{MAX_PARAMETERS, MAX_VALUE_BYTES, ensure_at_most};
use super::parameters::{Parameters, compare};
use super::storyboard::StoryAction;
use super::trigger::ConditionKind;
use super::vocabulary::Rule;
use super::xml::Node;
use crumple_core::digits::format_compact;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Name of a variable or a parameter. Each kind has its own names.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ValueName {
    is_parameter: bool,
    name: String,
}

/// A change of a value by an action.
#[derive(Debug, Clone)]
pub(super) struct VariableChange {
    name: ValueName,
    change: ValueChange,
}

#[derive(Debug, Clone)]
enum ValueChange {
    Set(String),
    Add(f64),
    Multiply(f64),
}

/// A condition on a value.
#[derive(Debug, Clone)]
pub(super) struct ValueCondition {
    name: ValueName,
    rule: Rule,
    value: String,
}

/// Current values of variables and parameters.
#[derive(Debug, Clone, Default)]
pub(super) struct StoryVariables(BTreeMap<ValueName, StoryValue>);

/// A value, and the time at which an action set it.
#[derive(Debug, Clone)]
struct StoryValue {
    text: String,
    since_s: f64,
}

impl StoryValue {
    /// Returns the value at the start.
    fn initial(text: String) -> Self {
        Self {
            text,
            since_s: f64::NEG_INFINITY,
        }
    }
}

impl StoryVariables {
    /// Returns the initial values.
    pub(super) fn new(root: Node<'_>, parameters: &Parameters) -> Result<Self> {
        let mut values = BTreeMap::new();
        for (name, text) in parameters.iter() {
            let value = StoryValue::initial(text.to_owned());
            values.insert(value_name(true, name), value);
        }
        if let Some(list) = root.optional("VariableDeclarations") {
            list.only(&["VariableDeclaration"], &[])?;
            let count = list.children().count();
            ensure_at_most(list, count, MAX_PARAMETERS, "variables")?;
            for declaration in list.children() {
                declaration.only(&[], &["name", "variableType", "value"])?;
                let value = bounded(declaration, declaration.text("value")?)?;
                let name = value_name(false, &declaration.text("name")?);
                values.insert(name, StoryValue::initial(value));
            }
        }
        Ok(Self(values))
    }

    /// Changes a value at a time.
    pub(super) fn change(
        &mut self,
        node: Node<'_>,
        change: &VariableChange,
        time_s: f64,
    ) -> Result<()> {
        let name = &change.name;
        let value = self.0.get_mut(name).ok_or_else(|| unknown(node, name))?;
        value.since_s = time_s;
        let value = &mut value.text;
        let factor_and_offset = match &change.change {
            ValueChange::Set(text) => {
                text.clone_into(value);
                return Ok(());
            }
            ValueChange::Add(offset) => [1.0, *offset],
            ValueChange::Multiply(factor) => [*factor, 0.0],
        };
        let number = value.trim().parse::<f64>().ok();
        let changed = number.map(|number| factor_and_offset[0] * number + factor_and_offset[1]);
        match changed.filter(|changed| changed.is_finite()) {
            Some(changed) => *value = format_compact(changed),
            None => return Err(node.refuse(format!("`{}` = `{value}` is not a number", name.name))),
        }
        Ok(())
    }

    /// Returns true if a condition on a value holds.
    pub(super) fn holds(&self, node: Node<'_>, condition: &ValueCondition) -> Result<bool> {
        let name = &condition.name;
        let value = self.0.get(name).ok_or_else(|| unknown(node, name))?;
        compare(&value.text, condition.rule, &condition.value).map_err(|reason| node.refuse(reason))
    }

    /// Returns the time at which an action set the value of a condition.
    pub(super) fn since_s(&self, condition: &ValueCondition) -> Option<f64> {
        self.0.get(&condition.name).map(|value| value.since_s)
    }
}

fn unknown(node: Node<'_>, name: &ValueName) -> ScenarioImportError {
    let kind = if name.is_parameter {
        "parameter"
    } else {
        "variable"
    };
    node.refuse(format!("there is no {kind} `{}`", name.name))
}

fn value_name(is_parameter: bool, name: &str) -> ValueName {
    ValueName {
        is_parameter,
        name: name.to_owned(),
    }
}

/// Refuses a value that is too long.
fn bounded(node: Node<'_>, value: String) -> Result<String> {
    if value.len() > MAX_VALUE_BYTES {
        return Err(node.refuse(format!("a value has more than {MAX_VALUE_BYTES} bytes")));
    }
    Ok(value)
}

/// Reads `ParameterAction` or `VariableAction`.
pub(super) fn read_variable_change<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<StoryAction<'a>> {
    let is_parameter = node.name() == "ParameterAction";
    let reference = if is_parameter {
        "parameterRef"
    } else {
        "variableRef"
    };
    node.only(&["SetAction", "ModifyAction"], &[reference])?;
    let name = value_name(is_parameter, &node.text(reference)?);
    let inner = node.single()?;
    let change = if inner.name() == "SetAction" {
        inner.only(&[], &["value"])?;
        ValueChange::Set(bounded(inner, inner.text("value")?)?)
    } else {
        let rule = inner.child("Rule")?.single()?;
        rule.only(&[], &["value"])?;
        let value = rule.number("value")?;
        match rule.name() {
            "AddValue" => ValueChange::Add(value),
            "MultiplyByValue" => ValueChange::Multiply(value),
            _ => return Err(rule.refuse("is not supported as a rule")),
        }
    };
    Ok(StoryAction::Variable(VariableChange { name, change }))
}

/// Reads `ParameterCondition` or `VariableCondition`.
pub(super) fn read_value_condition<'a>(
    node: Node<'a>,
    _entities: &[Entity<'_>],
) -> Result<ConditionKind<'a>> {
    let is_parameter = node.name() == "ParameterCondition";
    let reference = if is_parameter {
        "parameterRef"
    } else {
        "variableRef"
    };
    node.only(&[], &[reference, "value", "rule"])?;
    Ok(ConditionKind::Value(ValueCondition {
        name: value_name(is_parameter, &node.text(reference)?),
        rule: node.word("rule")?,
        value: bounded(node, node.text("value")?)?,
    }))
}
