//! Batching of questions from several threads.
//!
//! Shrinking evaluates one scenario after the other, but simulation is much faster in batches. All failures are
//! therefore shrunk at once, each on a thread that mostly waits.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

const MAX_BATCH_SIZE: usize = 64;

/// A message of a thread: its index, and its question; `None` at its end.
type Question<Q> = (usize, Option<Q>);

/// Client side of one thread, which asks one question at a time.
struct QuestionSender<Q, A> {
    index: usize,
    questions: Sender<Question<Q>>,
    answers: Receiver<A>,
}

impl<Q, A> QuestionSender<Q, A> {
    /// Sends a question and waits for the answer; `None` if the server has ended.
    fn ask(&self, question: Q) -> Option<A> {
        self.questions.send((self.index, Some(question))).ok()?;
        self.answers.recv().ok()
    }
}

impl<Q, A> Drop for QuestionSender<Q, A> {
    /// Reports the end of the thread, also on panic, so that the server does not wait for it.
    fn drop(&mut self) {
        let _ = self.questions.send((self.index, None));
    }
}

/// Runs `work` for each member on its own thread. `answer` receives all waiting questions together, in the order of the
/// members. The question function returns `None` only if `answer` returned too few answers.
pub(super) fn run_batched<M: Sync, Q: Send, A: Send, R: Send>(
    members: &[M],
    work: impl Fn(&M, &mut dyn FnMut(Q) -> Option<A>) -> R + Sync,
    answer: impl Fn(&[Q]) -> Vec<A>,
) -> Vec<R> {
    members
        .chunks(MAX_BATCH_SIZE)
        .flat_map(|members| run_one_batch(members, &work, &answer))
        .collect()
}

fn run_one_batch<M: Sync, Q: Send, A: Send, R: Send>(
    members: &[M],
    work: &(impl Fn(&M, &mut dyn FnMut(Q) -> Option<A>) -> R + Sync),
    answer: &impl Fn(&[Q]) -> Vec<A>,
) -> Vec<R> {
    thread::scope(|scope| {
        let (questions, received_questions) = channel();
        let mut threads = Vec::new();
        let mut answer_senders = Vec::new();
        for (index, member) in members.iter().enumerate() {
            let (answer_sender, answers) = channel();
            answer_senders.push(Some(answer_sender));
            let sender = QuestionSender {
                index,
                questions: questions.clone(),
                answers,
            };
            threads.push(scope.spawn(move || work(member, &mut |question| sender.ask(question))));
        }
        drop(questions);
        serve(&received_questions, answer_senders, answer);
        let joined = threads.into_iter().map(|thread| thread.join());
        joined
            .map(|done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
            .collect()
    })
}

fn serve<Q, A>(
    received_questions: &Receiver<Question<Q>>,
    mut answer_senders: Vec<Option<Sender<A>>>,
    answer: &impl Fn(&[Q]) -> Vec<A>,
) {
    let mut waiting: Vec<(usize, Q)> = Vec::new();
    loop {
        while waiting.len() < answer_senders.iter().flatten().count() {
            match received_questions.recv() {
                Ok((index, Some(question))) if answer_senders[index].is_some() => {
                    waiting.push((index, question))
                }
                Ok((index, _)) => answer_senders[index] = None,
                Err(_) => return,
            }
        }
        if waiting.is_empty() {
            return;
        }
        waiting.sort_by_key(|(index, _)| *index);
        let (indices, questions): (Vec<usize>, Vec<Q>) = waiting.drain(..).unzip();
        let mut answers = answer(&questions).into_iter();
        for index in indices {
            match (answers.next(), &answer_senders[index]) {
                (Some(answer), Some(answer_sender)) => drop(answer_sender.send(answer)),
                _ => answer_senders[index] = None,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    /// Results equal those of separate runs, whenever a thread ends, and questions are answered in batches.
    #[test]
    fn batched_answers_equal_single_answers() {
        let members: Vec<u64> = (0..150).map(|i| i * i % 23).collect();
        let batch_sizes = RefCell::new(Vec::new());
        let learned = run_batched(
            &members,
            |&member, ask| {
                (0..member)
                    .map(|step| ask(10 * member + step).unwrap())
                    .sum::<u64>()
            },
            |questions| {
                batch_sizes.borrow_mut().push(questions.len());
                questions
                    .iter()
                    .map(|question| question * question)
                    .collect()
            },
        );
        let alone = members
            .iter()
            .map(|m| (0..*m).map(|step| (10 * m + step).pow(2)).sum::<u64>());
        assert_eq!(learned, alone.collect::<Vec<_>>());
        let batch_sizes = batch_sizes.into_inner();
        assert_eq!(
            batch_sizes.iter().sum::<usize>() as u64,
            members.iter().sum::<u64>()
        );
        assert!(
            batch_sizes.len() <= 3 * 22 && batch_sizes[0] > 50,
            "{batch_sizes:?}"
        );
    }

    #[test]
    fn a_missing_answer_is_reported_and_blocks_no_thread() {
        let learned = run_batched(
            &[1, 2, 3],
            |_, ask| ask(0).is_some() && ask(0).is_some(),
            |all| vec![(); all.len() - 1],
        );
        assert_eq!(learned.len(), 3);
        assert!(!learned[2]);
        assert!(
            run_batched(
                &[0; 0],
                |_, _: &mut dyn FnMut(u8) -> Option<u8>| 1,
                |_| Vec::new()
            )
            .is_empty()
        );
    }
}
